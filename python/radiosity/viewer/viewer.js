// A solution in the browser: orbit, pan, walk; exposure; false colour; mesh lines; the numbers of a patch; bounces.
//
// The page holds one JSON header and one block of data, arrays one after the other, deflated, as base64. What is sent is
// linear: irradiance H, reflectance rho and emission E. Radiance (E + rho H) / pi is made here, and so are tone and colour.

import {
  BufferAttribute,
  BufferGeometry,
  Color,
  DataTexture,
  DoubleSide,
  FrontSide,
  LineBasicMaterial,
  LineSegments,
  LinearSRGBColorSpace,
  Mesh,
  PerspectiveCamera,
  RGBAFormat,
  Raycaster,
  Scene,
  ShaderMaterial,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const element = (id) => document.getElementById(id);

async function read() {
  const header = JSON.parse(element("header").textContent);
  const bytes = Uint8Array.from(atob(element("data").textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const kinds = { f32: Float32Array, u32: Uint32Array, u16: Uint16Array };
  const arrays = {};
  for (const [name, kind, offset, length] of header.arrays) arrays[name] = new kinds[kind](buffer, offset, length);
  return { header, arrays };
}

// Half floats of all 65,536 bit patterns.
function halves() {
  const table = new Float32Array(65536);
  for (let bits = 0; bits < 65536; bits++) {
    const [exponent, fraction] = [(bits >> 10) & 31, bits & 1023];
    const size = exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024);
    table[bits] = bits & 32768 ? -size : size;
  }
  return table;
}

const vertexShader = `
  attribute vec3 value;
  varying vec3 seen;
  void main() {
    seen = value;
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  }`;

const fragmentShader = `
  uniform bool falseColour;
  uniform float scale;
  uniform sampler2D colours;
  varying vec3 seen;
  vec3 toSrgb(vec3 c) {
    return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
  }
  void main() {
    if (!gl_FrontFacing) { gl_FragColor = vec4(0.0, 0.0, 0.0, 1.0); return; }
    vec3 x = clamp(scale * seen, 0.0, 1.0);
    gl_FragColor = falseColour ? texture2D(colours, vec2(x.r, 0.5)) : vec4(toSrgb(x), 1.0);
  }`;

async function main() {
  const { header, arrays } = await read();
  const { faces, bands, frames } = header;
  const table = halves();

  // Corners of their own for every patch: no colour runs over an edge that it should not.
  const positions = new Float32Array(9 * faces);
  arrays.faces.forEach((v, k) => positions.set(arrays.vertices.subarray(3 * v, 3 * v + 3), 3 * k));
  const values = new BufferAttribute(new Float32Array(9 * faces), 3);
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setAttribute("value", values);
  geometry.computeBoundingSphere();
  const size = geometry.boundingSphere.radius;

  const colours = new DataTexture(Uint8Array.from(header.colours), 256, 1, RGBAFormat);
  colours.needsUpdate = true;
  const uniforms = { falseColour: { value: false }, scale: { value: 1 }, colours: { value: colours } };
  const material = new ShaderMaterial({ uniforms, vertexShader, fragmentShader, side: FrontSide });
  const mesh = new Mesh(geometry, material);
  const scene = new Scene();
  scene.background = new Color(0);
  scene.add(mesh);
  let lines = null;

  const canvas = element("view");
  const renderer = new WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
  renderer.outputColorSpace = LinearSRGBColorSpace; // the shader has made sRGB already
  renderer.setPixelRatio(window.devicePixelRatio);
  const camera = new PerspectiveCamera(header.camera.fov, 1, 1e-3 * size, 100 * size);
  camera.up.fromArray(header.camera.up);
  const controls = new OrbitControls(camera, canvas);
  const reset = () => {
    camera.position.fromArray(header.camera.origin);
    controls.target.fromArray(header.camera.target);
    controls.update();
    draw();
  };

  const state = { frame: frames.length - 1, shading: "smooth", mode: "radiance", picked: -1 };
  const draw = () => renderer.render(scene, camera);

  // Radiance, or the irradiance of all bands together, at the corners.
  function fill() {
    const { scale } = frames[state.frame];
    const [flat, smooth] = [arrays[`flat${state.frame}`], arrays[`smooth${state.frame}`]];
    const isFalse = state.mode === "irradiance";
    const out = values.array;
    for (let i = 0; i < faces; i++) {
      for (let c = 0; c < 3; c++) {
        const to = 3 * (3 * i + c);
        let sum = 0;
        for (let k = 0; k < 3; k++) {
          const b = bands === 1 ? 0 : k;
          const at = i * bands + b;
          const h = state.shading === "flat" ? flat[at] : scale * table[smooth[(3 * i + c) * bands + b]];
          if (isFalse) sum += header.weights[k] * h;
          else out[to + k] = (arrays.emission[at] + arrays.reflectance[at] * h) / Math.PI;
        }
        if (isFalse) out[to] = sum;
      }
    }
    values.needsUpdate = true;
    tone();
  }

  // Exposure in stops around the one that came with the page; or the largest irradiance shown.
  function tone() {
    const isFalse = state.mode === "irradiance";
    const stops = Number(element("exposure").value);
    const most = header.most * 2 ** -stops;
    uniforms.falseColour.value = isFalse;
    uniforms.scale.value = isFalse ? 1 / most : header.exposure * 2 ** stops;
    element("bar").hidden = !isFalse;
    element("most").textContent = `${most.toPrecision(3)} ${header.unit}`;
    element("stops").textContent = isFalse ? "" : `${stops >= 0 ? "+" : ""}${stops.toFixed(1)}`;
    draw();
  }

  function showLines(shown) {
    if (shown && !lines) {
      const edges = new BufferGeometry();
      const ends = new Float32Array(18 * faces);
      for (let i = 0; i < faces; i++) {
        for (let c = 0; c < 3; c++) {
          const next = (c + 1) % 3;
          ends.set(positions.subarray(9 * i + 3 * c, 9 * i + 3 * c + 3), 18 * i + 6 * c);
          ends.set(positions.subarray(9 * i + 3 * next, 9 * i + 3 * next + 3), 18 * i + 6 * c + 3);
        }
      }
      edges.setAttribute("position", new BufferAttribute(ends, 3));
      lines = new LineSegments(edges, new LineBasicMaterial({ color: 0x30a0ff, transparent: true, opacity: 0.5 }));
      material.polygonOffset = true;
      material.polygonOffsetFactor = material.polygonOffsetUnits = 1;
      scene.add(lines);
    }
    if (lines) lines.visible = shown;
    draw();
  }

  const raycaster = new Raycaster();
  // The patch at a point of the canvas, and its numbers.
  function pick(x, y) {
    const box = canvas.getBoundingClientRect();
    const at = new Vector2((2 * (x - box.left)) / box.width - 1, 1 - (2 * (y - box.top)) / box.height);
    raycaster.setFromCamera(at, camera);
    const [hit] = raycaster.intersectObject(mesh);
    state.picked = hit ? hit.faceIndex : -1;
    tell();
    return state.picked;
  }

  function tell() {
    const i = state.picked;
    element("patch").hidden = i < 0;
    if (i < 0) return;
    const row = (array) => Array.from(array.subarray(i * bands, (i + 1) * bands));
    const [h, rho, e] = [row(arrays[`flat${state.frame}`]), row(arrays.reflectance), row(arrays.emission)];
    const radiosity = h.map((h, b) => e[b] + rho[b] * h);
    const text = (numbers) => numbers.map((x) => x.toPrecision(4)).join("  ");
    const name = header.names.length ? `  ${header.names[arrays.name[i]]}` : "";
    element("patch").textContent = [
      `${header.what} ${i}${name}`,
      `B    ${text(radiosity)} W/m^2`,
      `H    ${text(h)} W/m^2`,
      `E    ${text(e)} W/m^2`,
      `rho  ${text(rho)}`,
    ].join("\n");
  }

  function resize() {
    const [width, height] = [window.innerWidth, window.innerHeight];
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    draw();
  }

  // Walking moves the camera and what it looks at; while it is on, dragging turns the head.
  const keys = new Set();
  let last = 0;
  function walk(time) {
    if (!keys.size) return;
    const step = 0.4 * size * Math.min((time - last) / 1000, 0.1);
    last = time;
    const forward = controls.target.clone().sub(camera.position).normalize();
    const right = forward.clone().cross(camera.up).normalize();
    const way = new Vector3();
    const along = { w: forward, arrowup: forward, d: right, arrowright: right, e: camera.up };
    const against = { s: forward, arrowdown: forward, a: right, arrowleft: right, q: camera.up };
    for (const key of keys) {
      if (along[key]) way.add(along[key]);
      if (against[key]) way.sub(against[key]);
    }
    way.multiplyScalar(step);
    camera.position.add(way);
    controls.target.add(way);
    controls.update();
    draw();
    requestAnimationFrame(walk);
  }
  window.addEventListener("keydown", (event) => {
    const key = event.key.toLowerCase();
    const isOther = event.ctrlKey || event.metaKey || event.altKey || /^(SELECT|INPUT)$/.test(event.target.tagName);
    if (isOther || !/^(w|a|s|d|q|e|arrow(up|down|left|right))$/.test(key)) return;
    event.preventDefault();
    const isFirst = !keys.size;
    keys.add(key);
    if (isFirst) {
      last = performance.now();
      requestAnimationFrame(walk);
    }
  });
  window.addEventListener("keyup", (event) => keys.delete(event.key.toLowerCase()));
  window.addEventListener("blur", () => keys.clear());

  function setWalk(isOn) {
    element("walk").checked = isOn;
    const ahead = controls.target.clone().sub(camera.position);
    // From a point just ahead of the camera, orbiting is turning the head.
    controls.target.copy(camera.position).add(ahead.setLength(isOn ? 1e-3 * size : size));
    controls.enableZoom = !isOn;
    controls.rotateSpeed = isOn ? -0.4 : 1;
    controls.update();
    draw();
  }
  element("walk").addEventListener("change", (event) => setWalk(event.target.checked));
  const choose = (name, value) => {
    state[name] = value;
    fill();
    tell();
  };
  element("mode").addEventListener("change", (event) => choose("mode", event.target.value));
  element("shading").addEventListener("change", (event) => choose("shading", event.target.value));
  element("exposure").addEventListener("input", tone);
  element("lines").addEventListener("change", (event) => showLines(event.target.checked));
  element("backs").addEventListener("change", (event) => {
    material.side = event.target.checked ? DoubleSide : FrontSide;
    material.needsUpdate = true;
    draw();
  });
  element("reset").addEventListener("click", () => {
    setWalk(false);
    reset();
  });
  const slider = element("frame");
  slider.max = slider.value = frames.length - 1;
  element("frames").hidden = frames.length < 2;
  const label = () => (element("label").textContent = frames[state.frame].label);
  slider.addEventListener("input", () => {
    choose("frame", Number(slider.value));
    label();
  });
  label();
  let down = null;
  canvas.addEventListener("pointerdown", (event) => (down = [event.clientX, event.clientY]));
  canvas.addEventListener("pointerup", (event) => {
    const isClick = down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) < 4;
    if (isClick) pick(event.clientX, event.clientY);
  });
  controls.addEventListener("change", draw);
  window.addEventListener("resize", resize);
  element("bar").style.setProperty("--colours", `linear-gradient(to right, ${header.gradient.join(",")})`);
  // In a small window the picture matters more.
  if (window.innerWidth < 700) element("panel").open = false;
  resize();
  reset();
  fill();
  // For tests: how long drawing takes, and what was picked.
  window.viewer = { state, pick, draw, camera, controls, renderer, ready: true };
}

main().catch((error) => {
  element("patch").hidden = false;
  element("patch").textContent = `The viewer cannot start: ${error.message}`;
  throw error;
});
