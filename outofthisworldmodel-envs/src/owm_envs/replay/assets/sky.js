// Sun and Earth as they stood, behind everything: drawn first, from the station's place, in kilometres.

class Sky {
  constructor(data, redraw) {
    this.scene = new THREE.Scene();
    this.known = data !== null;
    if (!this.known) return;
    this.times = decode(data.times, Float32Array);
    this.columns = Object.fromEntries(["sun", "sunlight", "earth_from_station"].map((name) => [name, decode(data[name], Float32Array)]));
    const earth = new THREE.SphereGeometry(6371, 192, 96).rotateX(Math.PI / 2); // Greenwich at x, north at z
    const map = new THREE.Texture(new Image());
    map.colorSpace = THREE.SRGBColorSpace;
    map.anisotropy = 8;
    map.image.onload = () => ((map.needsUpdate = true), redraw());
    map.image.src = data.map;
    this.uniforms = { map: { value: map }, sun: { value: new THREE.Vector3() } };
    this.earth = new THREE.Mesh(earth, new THREE.ShaderMaterial({ uniforms: this.uniforms, vertexShader: VERTEX, fragmentShader: GROUND }));
    const veil = new THREE.ShaderMaterial({ uniforms: this.uniforms, vertexShader: VERTEX, fragmentShader: AIR, side: THREE.BackSide, transparent: true, blending: THREE.AdditiveBlending, depthWrite: false });
    this.air = new THREE.Mesh(new THREE.SphereGeometry(6371 + 90, 192, 96), veil);
    this.earth.position.z = this.air.position.z = -data.distance;
    this.scene.add(this.earth, this.air);
  }

  at(time) {
    if (!this.known) return { sun: new THREE.Vector3(0.5, -0.55, 0.67), sunlight: 1 };
    let i = 0;
    while (i < this.times.length - 2 && this.times[i + 1] <= time) i++;
    const j = Math.min(i + 1, this.times.length - 1), step = this.times[j] - this.times[i], { sun, sunlight, earth_from_station: turns } = this.columns;
    const share = step > 0 ? Math.min(Math.max((time - this.times[i]) / step, 0), 1) : 0;
    const toward = (k) => new THREE.Vector3(...sun.subarray(3 * k, 3 * k + 3));
    // Rows of the rotation read as columns: its inverse, which takes the globe to the station frame.
    const turned = (k) => {
      const [x, y, z] = [0, 3, 6].map((row) => vector(turns.subarray(9 * k + row, 9 * k + row + 3)));
      return new THREE.Quaternion().setFromRotationMatrix(new THREE.Matrix4().makeBasis(x, y, z));
    };
    this.earth.quaternion.copy(turned(i).slerp(turned(j), share));
    const found = { sun: toward(i).lerp(toward(j), share).normalize(), sunlight: sunlight[i] + share * (sunlight[j] - sunlight[i]) };
    this.uniforms.sun.value.copy(found.sun);
    return found;
  }
}

const VERTEX = `
varying vec2 place; varying vec3 up; varying vec3 seen;
void main() {
  place = uv;
  up = normalize(mat3(modelMatrix) * position);
  vec4 world = modelMatrix * vec4(position, 1.0);
  seen = world.xyz - cameraPosition;
  gl_Position = projectionMatrix * viewMatrix * world;
}`;

// Day by the map, night nearly black, and more air in between the lower one looks.
const GROUND = `
uniform sampler2D map; uniform vec3 sun; varying vec2 place; varying vec3 up; varying vec3 seen;
void main() {
  float day = smoothstep(-0.08, 0.25, dot(up, sun));
  float air = pow(1.0 - max(dot(normalize(up), -normalize(seen)), 0.0), 2.5);
  vec3 ground = texture2D(map, place).rgb * 0.62 + vec3(0.006, 0.010, 0.018);
  vec3 colour = mix(ground, vec3(0.22, 0.42, 0.80), 0.12 + 0.7 * air) * (0.02 + 0.98 * day * max(dot(up, sun), 0.15));
  gl_FragColor = vec4(colour, 1.0);
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
}`;

const AIR = `
uniform vec3 sun; varying vec3 up; varying vec3 seen;
void main() {
  float day = smoothstep(-0.25, 0.3, dot(up, sun));
  float edge = clamp(-dot(normalize(up), -normalize(seen)) * 5.5, 0.0, 1.0);
  gl_FragColor = vec4(vec3(0.20, 0.45, 1.0) * edge * edge * (0.02 + 0.6 * day), 1.0);
  #include <tonemapping_fragment>
  #include <colorspace_fragment>
}`;
