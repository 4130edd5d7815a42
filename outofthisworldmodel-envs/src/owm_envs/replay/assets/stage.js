// What looks at the world: the camera's four places, labels, and the small picture from the nose.

const MODES = ["orbit", "chase", "nose", "port"];
const LENS_TURN = new THREE.Quaternion(0, 1, 0, 0); // our lenses look along +z with x to the left, three's along -z

class Stage {
  constructor(element, data, flight, redraw) {
    Object.assign(this, { element, data, flight, mode: "orbit" });
    const canvas = element.querySelector("#view");
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.autoClear = false;
    this.renderer.toneMapping = THREE.ACESFilmicToneMapping;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.shadowMap.autoUpdate = false; // once for all views of an instant, not for each
    this.world = new World(data, flight);
    this.sky = new Sky(data.sky, redraw);
    const camera = () => Object.assign(new THREE.PerspectiveCamera(40, 1, 0.3, 4000), { up: new THREE.Vector3(0, 0, 1) });
    this.free = camera();
    this.fixed = camera();
    this.far = camera();
    Object.assign(this.far, { near: 10, far: 20000 });
    this.controls = new THREE.OrbitControls(this.free, canvas);
    this.controls.enableDamping = false;
    Object.assign(this.controls, { maxDistance: 1500, minDistance: 3 });
    this.controls.addEventListener("change", redraw);
    this.labels = [...data.ports.map((port, k) => [port.name.replaceAll("_", " "), vector(port.interface).addScaledVector(vector(port.normal), 2), k === data.port ? "goal" : ""]),
      ["chaser", this.world.chaser.position, "chaser"]].map(([text, place, kind]) => {
      const span = element.querySelector("#labels").appendChild(document.createElement("span"));
      Object.assign(span, { textContent: text, className: kind });
      return { span, place, kind };
    });
    this.overview();
  }

  // From the port's side, so that hull and path are in the picture.
  overview() {
    const normal = vector(this.data.ports[this.data.port].normal), box = new THREE.Box3().setFromArray(this.world.points);
    for (const corner of [[-40, -24, -16], [40, 36, 16]]) box.expandByPoint(vector(corner));
    const sphere = box.getBoundingSphere(new THREE.Sphere());
    const side = new THREE.Vector3(0.5, -0.68, 0.42).add(normal.multiplyScalar(0.45)).normalize();
    this.controls.target.copy(sphere.center);
    this.free.position.copy(sphere.center).addScaledVector(side, sphere.radius * 2.35);
    this.controls.update();
  }

  // The camera that a mode looks through, put where it is.
  camera() {
    const mount = this.data.cameras[this.mode];
    this.controls.enabled = !mount;
    if (!mount) return this.free;
    this.aim(this.fixed, mount);
    return this.fixed;
  }

  aim(camera, { mount, position, attitude, field }) {
    const base = mount === "chaser" ? this.world.chaser : { position: new THREE.Vector3(), quaternion: new THREE.Quaternion() };
    camera.position.copy(vector(position)).applyQuaternion(base.quaternion).add(base.position);
    camera.quaternion.copy(base.quaternion).multiply(scalarFirst(attitude)).multiply(LENS_TURN);
    camera.fov = field;
  }

  look(camera, width, height, lower = 0) {
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    this.renderer.setViewport(0, lower, width, height);
    this.renderer.setScissor(0, lower, width, height);
    this.renderer.setScissorTest(true);
    this.renderer.setClearColor(0x05070c);
    this.renderer.clear();
    this.world.lamp.position.set(-0.5, 0.6, 1).applyQuaternion(camera.quaternion);
    this.far.quaternion.copy(camera.quaternion);
    Object.assign(this.far, { fov: camera.fov, aspect: camera.aspect });
    this.far.updateProjectionMatrix();
    this.far.updateMatrixWorld();
    this.renderer.render(this.sky.scene, this.far);
    this.renderer.clearDepth();
    this.renderer.render(this.world.scene, camera);
  }

  draw(time, nose) {
    const { clientWidth: width, clientHeight: height } = this.element, scale = Math.min(window.devicePixelRatio || 1, 2);
    if (!width || !height) return;
    if (this.width !== width || this.height !== height || this.scale !== scale) {
      Object.assign(this, { width, height, scale });
      this.renderer.setPixelRatio(scale);
      this.renderer.setSize(width, height, false);
    }
    const heavens = this.sky.at(time);
    this.world.place(time, heavens);
    this.renderer.shadowMap.needsUpdate = true;
    if (nose) this.small(nose);
    const camera = this.camera();
    this.world.ghost.visible = this.mode !== "port"; // it would fill the picture
    this.look(camera, width, height);
    this.label(camera, width, height);
    return { heavens, camera };
  }

  // What the nose camera would see: drawn into a corner of the canvas and copied from there, then overdrawn.
  small(canvas) {
    const marks = ["hull", "ports", "path", "thrust", "goal"].map((name) => this.world.layers[name]);
    const kept = marks.map((layer) => layer.visible), { scale } = this;
    const size = Math.min(canvas.width, Math.floor(Math.min(this.width, this.height) * scale)) / scale;
    marks.forEach((layer) => (layer.visible = false));
    const mode = this.mode;
    this.aim(this.fixed, this.data.cameras.nose);
    this.look(this.fixed, size, size);
    marks.forEach((layer, k) => (layer.visible = kept[k]));
    this.mode = mode;
    const source = this.renderer.domElement;
    canvas.getContext("2d").drawImage(source, 0, source.height - size * scale, size * scale, size * scale, 0, 0, canvas.width, canvas.height);
  }

  label(camera, width, height) {
    const taken = [], apart = ({ place }) => camera.position.distanceTo(place);
    const rank = (label) => (label.kind === "goal" ? 0 : label.kind === "chaser" ? 1 : 2 + apart(label));
    for (const label of [...this.labels].sort((a, b) => rank(a) - rank(b))) {
      const { span, place, kind } = label, seen = place.clone().project(camera);
      const wanted = kind === "chaser" ? apart(label) > 45 : this.world.layers.ports.visible && (kind || this.mode === "orbit");
      const [x, y, wide] = [((seen.x + 1) * width) / 2 + 8, ((1 - seen.y) * height) / 2 - 9, 8 + 6.2 * span.textContent.length];
      const crowded = taken.some((other) => x < other.x + other.wide && other.x < x + wide && Math.abs(y - other.y) < 17);
      span.hidden = !wanted || crowded || Math.abs(seen.z) > 1 || Math.abs(seen.x) > 1 || Math.abs(seen.y) > 1;
      if (!span.hidden) taken.push({ x, y, wide });
      span.style.transform = `translate(${x}px, ${y}px)`;
    }
  }
}

// The axes of the station frame as the camera sees them.
function drawTriad(canvas, camera) {
  const pen = canvas.getContext("2d"), middle = canvas.width / 2, turn = camera.quaternion.clone().invert();
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.font = "600 24px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.lineWidth = 5;
  pen.lineCap = "round";
  ["x", "y", "z"].map((name, k) => [name, new THREE.Vector3().setComponent(k, 1).applyQuaternion(turn)])
    .sort(([, a], [, b]) => a.z - b.z)
    .forEach(([name, axis]) => {
      pen.globalAlpha = axis.z < -0.2 ? 0.55 : 1;
      pen.strokeStyle = pen.fillStyle = LINES[name];
      pen.beginPath();
      pen.moveTo(middle, middle);
      pen.lineTo(middle + 52 * axis.x, middle - 52 * axis.y);
      pen.stroke();
      pen.fillText(name, middle + 70 * axis.x, middle - 70 * axis.y);
    });
  pen.globalAlpha = 1;
}
