// What was flown: numbers by name, and what lies between two recorded instants. Draws nothing.

function decode(text, Kind) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Kind(bytes.buffer);
}

class Flight {
  constructor(data) {
    this.times = decode(data.times, Float32Array);
    this.state = decode(data.state, Float32Array); // 13 numbers an instant: position, velocity, attitude, rate
    this.duration = this.times[this.times.length - 1];
    this.held = new Set(data.held);
    this.columns = {};
    for (const [name, text] of Object.entries(data.columns)) this.columns[name] = decode(text, Float32Array);
  }

  // The last recorded instant that is not after a time.
  row(time) {
    let low = 0, high = this.times.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= time) low = middle; else high = middle - 1;
    }
    return low;
  }

  // That instant, the next one, and how far between them a time lies.
  between(time) {
    const row = this.row(time), next = Math.min(row + 1, this.times.length - 1);
    const step = this.times[next] - this.times[row];
    return [row, next, step > 0 ? Math.min(Math.max((time - this.times[row]) / step, 0), 1) : 0];
  }

  // Where the chaser is: position straight, attitude on the shortest arc; the quaternion is three's, scalar last.
  pose(time, position = new THREE.Vector3(), attitude = new THREE.Quaternion()) {
    const [row, next, share] = this.between(time), at = (i, k) => this.state[13 * i + k];
    position.set(at(row, 0), at(row, 1), at(row, 2)).lerp(new THREE.Vector3(at(next, 0), at(next, 1), at(next, 2)), share);
    const turned = (i) => new THREE.Quaternion(at(i, 7), at(i, 8), at(i, 9), at(i, 6)).normalize();
    attitude.copy(turned(row)).slerp(turned(next), share);
    return { position, attitude };
  }

  // A column at a time: straight between instants, or as it was held from one to the next.
  value(name, time) {
    const [row, next, share] = this.between(time), column = this.columns[name];
    if (this.held.has(name)) return column[row];
    return column[row] + share * (column[next] - column[row]);
  }

  vector(kind, time) {
    return new THREE.Vector3(...["x", "y", "z"].map((axis) => this.value(`${kind}_${axis}`, time)));
  }
}
