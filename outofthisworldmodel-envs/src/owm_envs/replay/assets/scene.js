// The station, the chaser and what is drawn about them, in the station frame; metres.

const COLOURS = { path: 0xffd65c, goal: 0x60f0a0, port: 0x6fb6ff, force: 0xff9a3c, torque: 0xc690ff, hull: 0x4a7fb5 };
const CORRIDOR = { length: 30, slope: Math.tan(Math.PI / 18) };
const QUARTER = Math.PI / 2;
const vector = (values) => new THREE.Vector3(...values);
const scalarFirst = ([w, x, y, z]) => new THREE.Quaternion(x, y, z, w);

// One part of the table as a solid: local z along its axis, local x along its side.
function solid({ primitive, position, axis, side, dimensions: [a, b, c] }) {
  let shape;
  if (primitive === "sphere") shape = new THREE.SphereGeometry(a / 2, 24, 16);
  else if (primitive === "cylinder" || primitive === "cone") shape = new THREE.CylinderGeometry(b / 2, a / 2, c, 32).rotateX(QUARTER);
  else shape = new THREE.BoxGeometry(a, b, c);
  const z = vector(axis), x = vector(side), y = new THREE.Vector3().crossVectors(z, x);
  return shape.applyMatrix4(new THREE.Matrix4().makeBasis(x, y, z).setPosition(vector(position)));
}

// Many solids as one, so that a material is one call to draw.
function merged(shapes) {
  const whole = new THREE.BufferGeometry(), index = [];
  for (const name of ["position", "normal"]) {
    const arrays = shapes.map((shape) => shape.attributes[name].array);
    const all = new Float32Array(arrays.reduce((sum, array) => sum + array.length, 0));
    arrays.reduce((offset, array) => (all.set(array, offset), offset + array.length), 0);
    whole.setAttribute(name, new THREE.BufferAttribute(all, 3));
  }
  shapes.reduce((offset, shape) => {
    for (const corner of shape.index.array) index.push(corner + offset);
    return offset + shape.attributes.position.count;
  }, 0);
  whole.setIndex(index);
  return whole;
}

function vehicle(parts, materials) {
  const group = new THREE.Group();
  for (const [name, [colour, metalness, roughness]] of Object.entries(materials)) {
    const shapes = parts.filter((part) => part.material === name).map(solid);
    if (!shapes.length) continue;
    // There is nothing around for metal to mirror: it would look black.
    const material = new THREE.MeshStandardMaterial({ metalness: 0.4 * metalness, roughness });
    material.color.setRGB(...colour, THREE.SRGBColorSpace);
    const mesh = new THREE.Mesh(merged(shapes), material);
    mesh.name = name;
    mesh.castShadow = mesh.receiveShadow = true;
    group.add(mesh);
  }
  return group;
}

function polyline(points, colour, opacity = 1) {
  const shape = new THREE.BufferGeometry();
  shape.setAttribute("position", new THREE.BufferAttribute(points, 3));
  return new THREE.Line(shape, new THREE.LineBasicMaterial({ color: colour, transparent: opacity < 1, opacity }));
}

function hullLines(corners) {
  const points = [];
  for (let i = 0; i < corners.length; i += 6) {
    const corner = (bits) => [0, 1, 2].map((k) => corners[i + k + 3 * ((bits >> k) & 1)]);
    for (let from = 0; from < 8; from++)
      for (let k = 0; k < 3; k++) if (!(from & (1 << k))) points.push(...corner(from), ...corner(from | (1 << k)));
  }
  const shape = new THREE.BufferGeometry();
  shape.setAttribute("position", new THREE.BufferAttribute(new Float32Array(points), 3));
  return new THREE.LineSegments(shape, new THREE.LineBasicMaterial({ color: COLOURS.hull, transparent: true, opacity: 0.55 }));
}

// A port's mating plane and the corridor that opens outwards from it.
function portMarks(port, chosen) {
  const group = new THREE.Group(), colour = chosen ? COLOURS.goal : COLOURS.port;
  const ring = new THREE.Mesh(new THREE.TorusGeometry(0.85, 0.06, 8, 48), new THREE.MeshBasicMaterial({ color: colour }));
  const { length, slope } = CORRIDOR;
  const cone = new THREE.CylinderGeometry(length * slope, 0, length, 40, 1, true).translate(0, length / 2, 0).rotateX(QUARTER);
  const veil = { color: colour, transparent: true, opacity: chosen ? 0.08 : 0.035, side: THREE.DoubleSide, depthWrite: false };
  const rim = new THREE.Mesh(new THREE.TorusGeometry(length * slope, 0.04, 6, 72), new THREE.MeshBasicMaterial({ ...veil, opacity: chosen ? 0.8 : 0.3 }));
  rim.position.z = length;
  group.add(ring, rim, new THREE.Mesh(cone, new THREE.MeshBasicMaterial(veil)));
  group.position.copy(vector(port.interface));
  group.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), vector(port.normal));
  return group;
}

// Station, chaser and all marks; `place` puts them as they were at a time.
class World {
  constructor(data, flight) {
    Object.assign(this, { data, flight, scene: new THREE.Scene() });
    const layers = ["station", "hull", "ports", "path", "thrust", "goal"];
    this.layers = Object.fromEntries(layers.map((name) => [name, this.scene.add(new THREE.Group()).children.at(-1)]));
    const { station, hull, ports, path, thrust, goal } = this.layers;
    station.add(vehicle(data.parts.station, data.materials));
    this.chaser = vehicle(data.parts.chaser, data.materials);
    this.scene.add(this.chaser);
    hull.add(hullLines(decode(data.boxes, Float32Array)));
    hull.visible = false;
    data.ports.forEach((port, number) => ports.add(portMarks(port, number === data.port)));

    const points = new Float32Array((flight.state.length / 13) * 3);
    for (let i = 0; i < points.length; i++) points[i] = flight.state[13 * Math.floor(i / 3) + (i % 3)];
    // The flown part ends at the chaser, so it has one point more.
    this.flown = polyline(Float32Array.of(...points.slice(0, 3), ...points), COLOURS.path);
    this.flown.frustumCulled = false;
    path.add(polyline(points, COLOURS.path, 0.3), this.flown);
    this.points = points;

    const ghost = this.chaser.clone();
    ghost.traverse((mesh) => {
      if (mesh.isMesh) mesh.material = new THREE.MeshBasicMaterial({ color: COLOURS.goal, transparent: true, opacity: 0.04, depthWrite: false });
      mesh.castShadow = false;
    });
    ghost.position.copy(vector(data.goal.slice(0, 3)));
    ghost.quaternion.copy(scalarFirst(data.goal.slice(3)));
    goal.add((this.ghost = ghost));

    this.arrows = ["force", "torque"].map((kind) => {
      const arrow = new THREE.ArrowHelper(new THREE.Vector3(0, 0, 1), new THREE.Vector3(), 1, COLOURS[kind]);
      thrust.add(arrow);
      return arrow;
    });
    // Bright at its apex and black, which adds nothing, at its end.
    const flame = new THREE.ConeGeometry(0.45, 1, 24, 1, true).translate(0, -0.5, 0), { count } = flame.attributes.position;
    const glow = Float32Array.from({ length: 3 * count }, (_, i) => (flame.attributes.position.array[i - (i % 3) + 1] > -0.5 ? [0.2, 0.3, 0.5][i % 3] : 0));
    flame.setAttribute("color", new THREE.BufferAttribute(glow, 3));
    this.plume = new THREE.Mesh(flame, new THREE.MeshBasicMaterial({ vertexColors: true, toneMapped: false, transparent: true, blending: THREE.AdditiveBlending, depthWrite: false, side: THREE.DoubleSide }));
    thrust.add(this.plume);

    this.sun = new THREE.DirectionalLight(0xfff6e8, 3);
    Object.assign(this.sun.shadow.camera, { left: -75, right: 75, bottom: -75, top: 75, near: 50, far: 450 });
    this.sun.shadow.mapSize.set(2048, 2048);
    this.sun.shadow.normalBias = 0.08;
    this.sun.castShadow = true;
    this.fill = new THREE.AmbientLight(0xaec4e8, 0.35);
    this.earthshine = new THREE.HemisphereLight(0x05070c, 0x6d8fc0, 0.7); // the Earth is below
    this.earthshine.position.set(0, 0, 1);
    this.lamp = new THREE.DirectionalLight(0xd8e4ff, 0); // the viewer's own, above all in the Earth's shadow
    this.scene.add(this.sun, this.fill, this.earthshine, this.lamp);
  }

  place(time, heavens) {
    const { position, attitude } = this.flight.pose(time, this.chaser.position, this.chaser.quaternion);
    const row = this.flight.row(time), track = this.flown.geometry;
    track.attributes.position.array.set(this.points.subarray(0, 3 * (row + 1)));
    track.attributes.position.array.set(position.toArray(), 3 * (row + 1));
    track.attributes.position.needsUpdate = true;
    track.setDrawRange(0, row + 2);

    this.data.limits && ["force", "torque"].forEach((kind, k) => {
      const value = this.flight.vector(kind, time), share = value.length() / this.data.limits[k], arrow = this.arrows[k];
      arrow.visible = share > 1e-3;
      if (!arrow.visible) return;
      arrow.position.copy(position);
      arrow.setDirection(value.normalize().applyQuaternion(attitude));
      arrow.setLength(4.5 + 6 * share, 1.1, 0.55);
    });
    const [force] = this.arrows, share = this.flight.vector("force", time).length() / this.data.limits[0];
    this.plume.visible = force.visible;
    this.plume.quaternion.copy(force.quaternion);
    this.plume.position.copy(position).addScaledVector(new THREE.Vector3(0, 1, 0).applyQuaternion(force.quaternion), -2);
    this.plume.scale.set(1 + share, 1 + 7 * share, 1 + share);

    this.sun.position.copy(heavens.sun).multiplyScalar(250);
    this.sun.intensity = 3 * heavens.sunlight;
    this.earthshine.intensity = 0.3 + 1.5 * heavens.sunlight;
    this.lamp.intensity = 0.3 + 1.3 * (1 - heavens.sunlight);
  }
}
