// The page: clock, keys and switches. `window.replay` is for whoever wants to steer it from outside.

const data = JSON.parse(document.getElementById("data").textContent);
const find = (id) => document.getElementById(id);
const flight = new Flight(data);
const replay = (window.replay = { flight, time: 0, playing: false, seek, play, mode, show, draw, stage: null, drawn: 0 });
const SPEEDS = [0.25, 1, 2, 5, 10, 20, 50];
const LAYERS = { station: "station", hull: "hull boxes", ports: "ports and corridors", path: "path", thrust: "thrust", goal: "hold pose" };
const SWATCHES = { hull: "#4a7fb5", ports: "#6fb6ff", path: "#ffd65c", thrust: "#ff9a3c", goal: "#60f0a0" };

let waiting = false;
function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => ((waiting = false), draw()));
}

function seek(time) {
  replay.time = Math.min(Math.max(Number(time) || 0, 0), flight.duration);
  redraw();
}

let last = null;
function tick(now) {
  if (!replay.playing) return;
  if (last !== null) replay.time = Math.min(replay.time + ((now - last) / 1000) * Number(find("speed").value), flight.duration);
  last = now;
  draw();
  if (replay.time >= flight.duration) play(false); else requestAnimationFrame(tick);
}

function play(on = !replay.playing) {
  if (on && replay.time >= flight.duration) replay.time = 0;
  replay.playing = on;
  last = null;
  find("play").textContent = on ? "\u23f8\ufe0e" : "\u25b6\ufe0e";
  find("play").setAttribute("aria-label", on ? "Pause" : "Play");
  if (on) requestAnimationFrame(tick);
}

function mode(name) {
  if (replay.stage) replay.stage.mode = name;
  for (const button of find("modes").children) button.setAttribute("aria-pressed", String(button.textContent === name));
  redraw();
}

function show(layer, on) {
  find(`show-${layer}`).checked = on;
  if (replay.stage) replay.stage.world.layers[layer].visible = on;
  redraw();
}

// The recorded frame of a time: the last one taken by then.
function shot(time) {
  let k = 0;
  while (k < data.frames.rows.length - 1 && flight.times[data.frames.rows[k + 1]] <= time) k++;
  return k;
}

function draw() {
  const { time, stage } = replay, row = flight.row(time);
  find("time").value = time;
  const whole = document.createElement("small");
  whole.textContent = ` / ${flight.duration.toFixed(2)} s \u00b7 instant ${row}`;
  find("clock").replaceChildren(time.toFixed(2), whole);
  if (data.frames) {
    const k = shot(time);
    if (replay.shot !== k) find("shot").src = data.frames.images[k];
    replay.shot = k;
  }
  for (const curve of curves) curve.draw(time);
  if (stage) {
    const seen = stage.draw(time, data.frames ? null : find("nose"));
    if (seen) {
      drawTriad(find("triad"), seen.camera);
      find("sky").textContent = !stage.sky.known ? "light of no particular time" : seen.heavens.sunlight > 0.5 ? "Sun and Earth as they stood" : "in the Earth's shadow, brightened";
    }
  }
  replay.drawn += 1;
}

for (const [label, value, kind] of data.facts) {
  const pair = find("facts").appendChild(document.createElement("div"));
  pair.appendChild(document.createElement("dt")).textContent = label;
  Object.assign(pair.appendChild(document.createElement("dd")), { textContent: value, className: kind ?? "" });
}
for (const name of MODES) {
  const button = find("modes").appendChild(document.createElement("button"));
  button.textContent = name;
  button.addEventListener("click", () => mode(name));
}
for (const [name, text] of Object.entries(LAYERS)) {
  const label = find("layers").appendChild(document.createElement("label")), box = label.appendChild(document.createElement("input"));
  Object.assign(box, { type: "checkbox", id: `show-${name}`, checked: name !== "hull" });
  box.addEventListener("change", () => show(name, box.checked));
  label.append(text);
  label.appendChild(document.createElement("i")).style.background = SWATCHES[name] ?? "none";
}
for (const speed of SPEEDS) find("speed").add(new Option(`${speed}\u00d7`, speed, speed === 10, speed === 10));
const curves = data.curves.map((spec) => new Curve(find("curves"), flight, spec, seek));
const caption = find("picture").querySelector("figcaption");
caption.textContent = data.frames ? data.frames.caption : "nose camera, drawn by this page";
find("shot").hidden = !data.frames;
find("nose").hidden = Boolean(data.frames);
find("time").max = flight.duration;
find("time").addEventListener("input", () => seek(find("time").value));
find("play").addEventListener("click", () => play());
// A click with the mouse leaves the keys to the page.
document.addEventListener("click", (event) => event.detail && event.target.closest("button, input[type=checkbox]")?.blur());
find("speed").addEventListener("change", () => find("speed").blur());

document.addEventListener("keydown", (event) => {
  const { target, key } = event;
  if (event.ctrlKey || event.metaKey || event.altKey || target.matches("select")) return;
  const row = flight.row(replay.time), stride = event.shiftKey ? 20 : 1, { times } = flight;
  const instant = (i) => seek(times[Math.min(Math.max(i, 0), times.length - 1)]);
  if (key === " " && !target.matches("button, input[type=checkbox]")) play();
  else if (key === "ArrowRight") instant(row + stride);
  // Between two instants, the one before is that which has just passed.
  else if (key === "ArrowLeft") instant(replay.time > times[row] && stride === 1 ? row : row - stride);
  else if (key === "Home") seek(0);
  else if (key === "End") seek(flight.duration);
  else if (MODES[Number(key) - 1]) mode(MODES[Number(key) - 1]);
  else return;
  if (replay.playing && key !== " " && !/^\d$/.test(key)) play(false);
  event.preventDefault();
});

function refuse(words) {
  replay.stage = null;
  Object.assign(find("notice"), { textContent: words, hidden: false });
  for (const id of ["view", "labels", "modes", "layers", "frame", "sky"]) find(id).hidden = true;
  if (!data.frames) find("picture").hidden = true;
  draw();
}

try {
  replay.stage = new Stage(find("stage"), data, flight, redraw);
  find("view").addEventListener("webglcontextlost", () => refuse("The browser has taken WebGL away from this page. Load it again to see the station; time line and curves go on without."));
  mode("orbit");
} catch (error) {
  console.warn(error);
  refuse("This browser offers no WebGL, so that the station cannot be drawn. Time line and curves work without.");
}
new ResizeObserver(redraw).observe(document.body);
draw();
