// Curves against time, each with a cursor that follows the clock and can be dragged.

const MARGIN = 38; // pixels left of the curves, for the numbers
const LINES = { x: "#ff7a72", y: "#7be08a", z: "#6fb6ff", "": "#5cc8ff" };

class Curve {
  constructor(parent, flight, spec, seek) {
    Object.assign(this, { flight, spec });
    const figure = parent.appendChild(document.createElement("figure"));
    figure.className = "curve";
    const caption = figure.appendChild(document.createElement("figcaption"));
    caption.append(`${spec.label} [${spec.unit}]`);
    this.now = caption.appendChild(document.createElement("span"));
    this.canvas = figure.appendChild(document.createElement("div")).appendChild(document.createElement("canvas"));
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `${spec.label} against time`);
    this.range = this.limits();
    const follow = (event) => {
      const box = this.canvas.getBoundingClientRect();
      seek(((event.clientX - box.left - MARGIN) / (box.width - MARGIN)) * flight.duration);
    };
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      follow(event);
    });
    this.canvas.addEventListener("pointermove", (event) => event.buttons && follow(event));
  }

  limits() {
    let low = Infinity, high = -Infinity;
    for (const name of this.spec.columns)
      for (const value of this.flight.columns[name].filter(Number.isFinite)) { low = Math.min(low, value); high = Math.max(high, value); }
    if (!Number.isFinite(low)) return [0, 1];
    this.log = this.spec.log && low > 0 && high > 20 * low;
    if (this.log) return [Math.log10(Math.max(low, high * 1e-5)), Math.log10(high)];
    if (this.spec.columns.length > 1) { high = Math.max(-low, high, 1e-9); low = -high; } else low = Math.min(low, 0);
    return [low, high > low ? high : low + 1];
  }

  // All but the cursor, once for each size.
  paint(width, height, scale) {
    const sheet = Object.assign(document.createElement("canvas"), { width, height }), pen = sheet.getContext("2d");
    const [low, high] = this.range, pad = 3 * scale;
    const y = (value) => height - pad - (((this.log ? Math.log10(Math.max(value, 10 ** low)) : value) - low) / (high - low)) * (height - 2 * pad);
    const left = MARGIN * scale, x = (time) => left + (time / this.flight.duration) * (width - left);
    let above = -Infinity;
    const rule = (value, text) => {
      const at = y(value);
      pen.fillStyle = "#1d2533";
      pen.fillRect(left, Math.round(at), width - left, Math.max(1, scale / 2));
      const place = Math.min(Math.max(at, 5 * scale), height - 6 * scale);
      if (Math.abs(place - above) < 11 * scale) return;
      pen.fillStyle = "#7d8aa0";
      pen.fillText(text, left - 5 * scale, (above = place));
    };
    pen.font = `${10 * scale}px system-ui, sans-serif`;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    if (this.log) for (let power = Math.floor(high); power >= low; power--) rule(10 ** power, String(Number((10 ** power).toPrecision(1))));
    else for (const value of low < 0 ? [high, 0, low] : [high, low]) rule(value, value ? short(value) : "0");
    pen.lineWidth = 1.3 * scale;
    pen.lineJoin = "round";
    const times = this.flight.times;
    for (const name of this.spec.columns) {
      const values = this.flight.columns[name], held = this.flight.held.has(name);
      pen.strokeStyle = LINES[name.split("_")[1] ?? ""];
      pen.beginPath();
      for (let i = 0, before = 0; i < times.length; i++) {
        const now = y(values[i]);
        if (held && i) pen.lineTo(x(times[i]), before);
        pen.lineTo(x(times[i]), (before = now));
      }
      pen.stroke();
    }
    return sheet;
  }

  draw(time) {
    const scale = window.devicePixelRatio || 1;
    const width = Math.round(this.canvas.clientWidth * scale), height = Math.round(this.canvas.clientHeight * scale);
    if (!width || !height) return;
    if (!this.sheet || this.sheet.width !== width || this.sheet.height !== height) {
      Object.assign(this.canvas, { width, height });
      this.sheet = this.paint(width, height, scale);
    }
    const pen = this.canvas.getContext("2d");
    pen.clearRect(0, 0, width, height);
    pen.drawImage(this.sheet, 0, 0);
    pen.fillStyle = "#ffffffcc";
    const left = MARGIN * scale, x = left + (time / this.flight.duration) * (width - left);
    pen.fillRect(Math.min(x, width - scale), 0, scale, height);
    this.now.replaceChildren(...this.spec.columns.map((name) => {
      const word = document.createElement("b"), axis = name.split("_")[1];
      if (axis) word.className = axis;
      word.textContent = short(this.flight.value(name, time));
      return word;
    }));
  }
}

function short(value) {
  const size = Math.abs(value);
  if (!Number.isFinite(value)) return "–";
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : 3).replace("-", "\u2212");
}
