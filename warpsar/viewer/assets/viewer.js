// The page of `warpsar view`. Its data stand in #data: see page.py. Lengths are metres about the reference point, Z up.
import {
  ArrowHelper, BufferAttribute, BufferGeometry, CanvasTexture, DataTexture, DepthTexture, DoubleSide, GridHelper, Group,
  LinearFilter, Matrix4, Mesh, MeshBasicMaterial, NearestFilter, OrbitControls, OrthographicCamera, PerspectiveCamera, Raycaster, RGBAFormat, Scene,
  ShaderMaterial, Sprite, SpriteMaterial, Texture, Vector2, Vector3, WebGLRenderer, WebGLRenderTarget,
} from "three";

const byId = (id) => document.getElementById(id);
const data = JSON.parse(byId("data").textContent);
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
const floats = (text) => new Float32Array(bytes(text).buffer);
const number = (value) => Number(value.toPrecision(3)).toString();
const LIT = "lit, shadow, layover";
const STRUCK = [[0.86, 0.84, 0.78], [0.93, 0.49, 0.13], [0.2, 0.22, 0.25]]; // lit, layover, shadow
const SHADOW_PIXELS = 2048;
const HOME = new Vector3(-0.45, -0.75, 0.6);

// ---- shaders ----------------------------------------------------------------------------------------------------------

const VERTEX = `
attribute float value;
varying vec3 place;
varying float carried;
void main() {
  place = position;
  carried = value;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;

const NONE = -1e30; // to the shader: a corner that has no value, which the page says by NaN

// mode 0: names, 1: a parameter, 2: an image of the view, 3: what the view lights
const FRAGMENT = `
uniform int mode;
uniform float count; // of names
uniform vec2 ends;
uniform bool logarithmic;
uniform sampler2D colours;
uniform sampler2D image;
uniform sampler2D layover;
uniform sampler2D nearest;
uniform mat4 toRadar;
uniform vec3 rangeAxis, azimuthAxis, elevationAxis, radarAxis;
uniform float slantRange;
uniform vec2 shape, spacing, shift;
uniform vec3 lit, over, shadow;
uniform float bias;
varying vec3 place;
varying float carried;

vec2 pixelOf() { // (column, row)
  float along = dot(place, rangeAxis);
  if (slantRange > 0.0) along = length(vec2(along + slantRange, dot(place, elevationAxis))) - slantRange;
  return vec2(dot(place, azimuthAxis), along) / spacing.yx + 0.5 * shape.yx + shift.yx;
}

void main() {
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  vec3 toEye = normalize(cameraPosition - place);
  if (dot(normal, toEye) < 0.0) normal = -normal;
  float shade = 0.62 + 0.38 * dot(normal, toEye);
  vec3 colour;
  if (mode == 0) {
    colour = texture2D(colours, vec2((carried + 0.5) / count, 0.5)).rgb;
  } else if (mode == 1 && carried < -1e29) {
    colour = vec3(0.36, 0.42, 0.47);
  } else if (mode == 1) {
    float at = logarithmic ? log(max(carried, 1e-30)) : carried;
    colour = texture2D(colours, vec2(clamp((at - ends.x) / max(ends.y - ends.x, 1e-9), 0.0, 1.0), 0.5)).rgb;
  } else {
    vec4 seen = toRadar * vec4(place, 1.0);
    seen = 0.5 * seen / seen.w + 0.5;
    float facing = dot(normal, radarAxis);
    float slack = bias * (1.0 + min(sqrt(1.0 - facing * facing) / max(facing, 0.05), 10.0));
    bool struck = facing > 0.0 && seen.z < texture2D(nearest, seen.xy).r + slack;
    vec2 at = pixelOf() / shape.yx;
    bool inside = all(greaterThanEqual(at, vec2(0.0))) && all(lessThan(at, vec2(1.0)));
    if (mode == 3) {
      bool two = inside && texture2D(layover, at).r > 0.5;
      colour = !struck ? shadow : two ? over : lit;
    } else {
      vec4 level = inside ? texture2D(image, at) : vec4(0.0);
      bool there = struck && level.a > 0.5;
      colour = there ? texture2D(colours, vec2(level.r * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb : vec3(0.36, 0.42, 0.47);
      if (there) shade = 0.5 + 0.5 * shade;
    }
  }
  gl_FragColor = vec4(colour * shade, 1.0);
}`;

// ---- what is drawn ----------------------------------------------------------------------------------------------------

function table(rgba) {
  const texture = new DataTexture(rgba, rgba.length / 4, 1, RGBAFormat);
  texture.minFilter = texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return texture;
}

const colourTables = Object.fromEntries(Object.entries(data.maps).map(([name, text]) => [name, table(bytes(text))]));
const nothing = table(new Uint8Array(4));

const kept = new Map(); // textures and their pixels by data URI
function picture(uri) {
  if (!kept.has(uri)) {
    const entry = { texture: new Texture(), pixels: null };
    entry.texture.minFilter = entry.texture.magFilter = NearestFilter;
    entry.texture.generateMipmaps = false;
    entry.texture.flipY = false;
    const image = new Image();
    image.onload = () => {
      const canvas = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height });
      const context = canvas.getContext("2d", { willReadFrequently: true });
      context.drawImage(image, 0, 0);
      entry.pixels = context.getImageData(0, 0, image.width, image.height);
      entry.texture.image = image;
      entry.texture.needsUpdate = true;
      draw();
    };
    image.src = uri;
    kept.set(uri, entry);
  }
  return kept.get(uri);
}

const uniforms = {
  mode: { value: 0 }, count: { value: 1 }, ends: { value: new Vector2() }, logarithmic: { value: false }, colours: { value: nothing },
  image: { value: nothing }, layover: { value: nothing }, nearest: { value: nothing }, toRadar: { value: new Matrix4() },
  rangeAxis: { value: new Vector3() }, azimuthAxis: { value: new Vector3() }, elevationAxis: { value: new Vector3() },
  radarAxis: { value: new Vector3() }, slantRange: { value: 0 }, shape: { value: new Vector2(1, 1) },
  spacing: { value: new Vector2(1, 1) }, shift: { value: new Vector2() }, bias: { value: 0 },
  lit: { value: new Vector3(...STRUCK[0]) }, over: { value: new Vector3(...STRUCK[1]) }, shadow: { value: new Vector3(...STRUCK[2]) },
};
const material = new ShaderMaterial({ vertexShader: VERTEX, fragmentShader: FRAGMENT, uniforms, side: DoubleSide });
const depthAlone = new MeshBasicMaterial({ side: DoubleSide });

const states = data.states.map((state) => {
  const geometry = new BufferGeometry();
  const corners = floats(state.corners);
  geometry.setAttribute("position", new BufferAttribute(corners, 3));
  geometry.setAttribute("value", new BufferAttribute(new Float32Array(corners.length / 3), 1));
  geometry.setIndex(new BufferAttribute(new Uint32Array(bytes(state.triangles).buffer), 1));
  geometry.computeBoundingBox();
  geometry.computeBoundingSphere();
  const groups = state.groups.map((one) => ({ ...one, index: new Uint16Array(bytes(one.index).buffer) }));
  const parameters = state.parameters.map((one) => ({ ...one, values: floats(one.values) }));
  return { ...state, groups, parameters, mesh: new Mesh(geometry, material) };
});

const ends = {}; // of the colours of a parameter: one scale for all states
for (const { label, log, ends: given } of states[0].parameters) {
  let [low, high] = given ?? [Infinity, -Infinity];
  for (const state of states) {
    for (const one of state.parameters.filter((each) => each.label === label)) {
      for (const value of one.values) if (!Number.isNaN(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
    }
  }
  ends[label] = { low, high, log };
}

const bounds = states[0].mesh.geometry.boundingBox.clone();
for (const state of states) bounds.union(state.mesh.geometry.boundingBox);
const middle = bounds.getCenter(new Vector3());
const reach = 0.5 * bounds.getSize(new Vector3()).length();

function label(text, height) {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d");
  const font = "500 40px system-ui, sans-serif";
  context.font = font;
  Object.assign(canvas, { width: Math.ceil(context.measureText(text).width) + 24, height: 56 });
  context.fillStyle = "rgba(255, 255, 255, 0.85)";
  context.fillRect(0, 0, canvas.width, canvas.height);
  Object.assign(context, { font, fillStyle: "#1c2126", textBaseline: "middle" });
  context.fillText(text, 12, canvas.height / 2 + 2);
  const texture = new CanvasTexture(canvas);
  texture.minFilter = LinearFilter;
  const sprite = new Sprite(new SpriteMaterial({ map: texture, depthTest: false }));
  sprite.scale.set((height * canvas.width) / canvas.height, height, 1);
  return sprite;
}

const step = [1, 2, 5].flatMap((n) => [0.1, 1, 10, 100, 1000, 10000].map((p) => n * p)).sort((a, b) => a - b)
  .find((one) => (2 * reach) / one <= 24) ?? 50000;
const squares = 2 * Math.ceil((1.15 * reach) / step);
const ground = new Group();
const lines = new GridHelper(squares * step, squares, 0xa3adb6, 0xd0d6dc);
lines.rotation.x = Math.PI / 2;
lines.position.set(middle.x, middle.y, bounds.min.z - 0.02 * reach); // well below the ground, which would flicker with it
const north = new ArrowHelper(new Vector3(0, 1, 0), new Vector3(middle.x, middle.y + (squares / 2) * step, lines.position.z), 0.16 * reach,
  0x1c6fb5, 0.06 * reach, 0.04 * reach);
const northSays = label("N", 0.075 * reach);
northSays.position.set(middle.x, middle.y + (squares / 2) * step + 0.22 * reach, lines.position.z);
ground.add(lines, north, northSays);
byId("grid-says").textContent = `grid of ${number(step)} m, north`;

const arrows = new Group();
function layArrows(views, chosen) {
  arrows.clear();
  for (const view of views) {
    const [d, , , s] = view.axes.map((axis) => new Vector3(...axis));
    const from = middle.clone().addScaledVector(s, 1.25 * reach);
    const colour = view === chosen ? 0xd1495b : 0x8a949e;
    arrows.add(new ArrowHelper(d, from, 0.3 * reach, colour, 0.09 * reach, 0.05 * reach));
    const says = label(view.name, view === chosen ? 0.075 * reach : 0.055 * reach);
    says.position.copy(from.addScaledVector(s, 0.06 * reach));
    arrows.add(says);
  }
}

// ---- the window -------------------------------------------------------------------------------------------------------

let renderer;
try {
  renderer = new WebGLRenderer({ canvas: byId("canvas"), antialias: true, alpha: true });
} catch (error) {
  byId("failure").hidden = false;
  byId("failure").textContent = "This browser shows no WebGL 2, which the 3D view needs.";
  throw error;
}
renderer.setPixelRatio(window.devicePixelRatio);
const scene = new Scene();
scene.add(ground, arrows);
const camera = new PerspectiveCamera(35, 1, 0.01 * reach, 20 * reach);
camera.up.set(0, 0, 1);
const controls = new OrbitControls(camera, byId("canvas"));
controls.addEventListener("change", () => draw());
controls.listenToKeyEvents(byId("canvas"));

const depth = new WebGLRenderTarget(SHADOW_PIXELS, SHADOW_PIXELS, { depthTexture: new DepthTexture(SHADOW_PIXELS, SHADOW_PIXELS) });
const lamp = new OrthographicCamera(-1.02 * reach, 1.02 * reach, 1.02 * reach, -1.02 * reach, 0, 2.1 * reach);

/** What lies nearest to the radar, as a map of depths: the rest is in shadow. */
function castShadows(view) {
  const [, , v, s] = view.axes.map((axis) => new Vector3(...axis));
  lamp.up.copy(v).negate();
  lamp.position.copy(middle).addScaledVector(s, 1.05 * reach);
  lamp.lookAt(middle);
  lamp.updateMatrixWorld();
  [ground.visible, arrows.visible] = [false, false];
  scene.overrideMaterial = depthAlone;
  renderer.setRenderTarget(depth);
  renderer.clear();
  renderer.render(scene, lamp);
  renderer.setRenderTarget(null);
  scene.overrideMaterial = null;
  showHelpers();
  uniforms.toRadar.value.multiplyMatrices(lamp.projectionMatrix, lamp.matrixWorldInverse);
  uniforms.nearest.value = depth.depthTexture;
  uniforms.bias.value = 2.04 / SHADOW_PIXELS; // a texel's width as a share of the depths
}

let asked = false;
function draw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    renderer.render(scene, camera);
    document.body.dataset.drawn = Number(document.body.dataset.drawn ?? 0) + 1;
  });
}

function fit() {
  const { clientWidth: width, clientHeight: height } = byId("canvas").parentElement;
  renderer.setSize(width, height, false);
  camera.aspect = width / height;
  camera.updateProjectionMatrix();
  draw();
}
new ResizeObserver(fit).observe(byId("canvas").parentElement);

function lookFrom(direction, distance) {
  controls.target.copy(middle);
  camera.position.copy(middle).addScaledVector(direction.clone().normalize(), distance * reach);
  controls.update();
  draw();
}

// ---- what is chosen ---------------------------------------------------------------------------------------------------

let state = states.at(-1); // the scene asked for; the one before it is for comparison
const chosenView = () => state.views[byId("view").selectedIndex] ?? state.views[0];

function options(select, names) {
  const before = select.value;
  select.replaceChildren(...names.map((name) => new Option(name, name)));
  if (names.includes(before)) select.value = before;
}

function quantities() {
  const images = [...new Set(state.views.flatMap((view) => Object.keys(view.images)))];
  const levels = state.parameters.filter((one) => one.ends); // of a page that is about them
  const others = [...state.groups, ...state.parameters.filter((one) => !one.ends)];
  const surface = [...levels, ...others].map((one) => one.label);
  return [...surface, ...(state.views.length ? [LIT] : []), ...images];
}

function showHelpers() {
  ground.visible = byId("grid").checked;
  arrows.visible = byId("arrows").checked;
}

const hex = (rgb) => `rgb(${rgb.map((one) => Math.round(one)).join(" ")})`;
const element = (name, text = "", style = {}) => {
  const made = Object.assign(document.createElement(name), { textContent: text });
  Object.assign(made.style, style);
  return made;
};

function listed(entries) {
  const list = element("ul");
  for (const [text, colour] of entries) {
    const item = element("li");
    item.append(element("i", "", { background: colour }), element("span", text));
    list.append(item);
  }
  byId("legend").replaceChildren(list);
}

/** The value at a share of a colour map, 0 to 1: linear between the levels of the scale. */
function decibels({ levels_db: levels, shares }, at) {
  const k = Math.max(1, shares.findIndex((one) => one >= at));
  return levels[k - 1] + ((levels[k] - levels[k - 1]) * (at - shares[k - 1])) / (shares[k] - shares[k - 1]);
}

/** The way back. */
function share({ levels_db: levels, shares }, decibel) {
  const k = Math.max(1, levels.findIndex((one) => one >= decibel));
  return shares[k - 1] + ((shares[k] - shares[k - 1]) * (decibel - levels[k - 1])) / (levels[k] - levels[k - 1]);
}

const BAR = [...Array(65).keys()].map((k) => k / 64);

/** A bar with numbers at even steps; `shares` of the colour map lie evenly along it. */
function barred(title, map, labels, note = "", shares = BAR) {
  const rgba = bytes(data.maps[map]);
  const stops = shares.map((one) => 4 * Math.round(255 * one)).map((k) => hex([...rgba.slice(k, k + 3)]));
  const bar = element("span", "", { background: `linear-gradient(to right, ${stops.join(", ")})` });
  bar.className = "bar";
  const marks = element("div");
  marks.className = "ends";
  marks.append(...labels.map((text) => element("span", text)));
  byId("legend").replaceChildren(element("span", title), bar, marks, element("span", note));
}

function show() {
  const quantity = byId("quantity").value;
  const view = chosenView();
  const group = state.groups.find((one) => one.label === quantity);
  const parameter = state.parameters.find((one) => one.label === quantity);
  const value = state.mesh.geometry.attributes.value;
  if (group) {
    uniforms.mode.value = 0;
    group.table ??= table(bytes(group.colours));
    uniforms.colours.value = group.table;
    uniforms.count.value = group.names.length;
    value.array.set(group.index);
    listed(group.names.map((name, k) => [name, hex([...bytes(group.colours).slice(4 * k, 4 * k + 3)])]));
  } else if (parameter) {
    const { low, high, log } = ends[quantity];
    uniforms.mode.value = 1;
    uniforms.colours.value = colourTables.viridis;
    uniforms.logarithmic.value = log;
    uniforms.ends.value.set(log ? Math.log(Math.max(low, 1e-30)) : low, log ? Math.log(Math.max(high, 1e-30)) : high);
    value.array.set(parameter.values.map((one) => (Number.isNaN(one) ? NONE : one)));
    barred(quantity, "viridis", [number(low), number(high)], log ? "steps are ratios" : "");
  } else {
    const [d, u, v, s] = view.axes;
    uniforms.rangeAxis.value.set(...d);
    uniforms.azimuthAxis.value.set(...u);
    uniforms.elevationAxis.value.set(...v);
    uniforms.radarAxis.value.set(...s);
    uniforms.slantRange.value = view.slant_range_m;
    uniforms.shape.value.set(...view.shape);
    uniforms.spacing.value.set(...view.spacing_m);
    uniforms.shift.value.set(...view.shift_px);
    castShadows(view);
    const image = view.images[quantity];
    if (quantity === LIT) {
      uniforms.mode.value = 3;
      uniforms.layover.value = picture(view.layover).texture;
      const colours = STRUCK.map((rgb) => hex(rgb.map((one) => 255 * one)));
      listed([[`lit by ${view.name}`, colours[0]], ["lit, with layover in its pixel", colours[1]], ["in shadow", colours[2]]]);
    } else {
      uniforms.mode.value = 2;
      uniforms.image.value = image ? picture(image.png).texture : nothing;
      const map = image ? image.scale.colours : "gray";
      uniforms.colours.value = colourTables[map];
      const meaning = quantity.startsWith("residual") ? "measured over modelled power; red: the measured image is brighter" : "beta0";
      if (image) {
        const [low, high] = [image.scale.levels_db[0], image.scale.levels_db.at(-1)];
        const along = (at) => low + (high - low) * at; // linear in dB
        const labels = [0, 0.5, 1].map((at) => `${number(along(at))} dB`);
        barred(`${quantity}, ${view.name}`, map, labels, meaning, BAR.map((at) => share(image.scale, along(at))));
      } else byId("legend").replaceChildren(element("span", `${view.name} has no such image`));
    }
  }
  value.needsUpdate = true;
  byId("of-view").textContent = view
    ? `${view.role ? `${view.role}; ` : ""}azimuth ${number(view.azimuth_deg)}°, incidence ${number(view.incidence_deg)}°` : "";
  layArrows(state.views, view);
  showHelpers();
  draw();
}

function choose(next) {
  scene.remove(state.mesh);
  state = next;
  scene.add(state.mesh);
  options(byId("quantity"), quantities());
  options(byId("view"), state.views.map((view) => view.name));
  show();
}

states.forEach((one, k) => {
  const radio = Object.assign(element("input"), { type: "radio", name: "state", value: one.name, checked: one === state });
  radio.addEventListener("change", () => choose(one));
  const wrap = element("label");
  wrap.append(radio, ` ${one.name}`);
  byId("states").append(wrap);
});
byId("states").hidden = states.length < 2;
for (const id of ["quantity", "view"]) byId(id).addEventListener("change", show);
for (const id of ["arrows", "grid"]) byId(id).addEventListener("change", () => { showHelpers(); draw(); });
byId("from-radar").addEventListener("click", () => {
  byId("arrows").checked = false; // the view's own would stand before the eye
  showHelpers();
  lookFrom(new Vector3(...chosenView().axes[3]), 3.6);
});
byId("home").addEventListener("click", () => lookFrom(HOME, 4.4));
byId("panel").addEventListener("submit", (event) => event.preventDefault());

// ---- values under the pointer -----------------------------------------------------------------------------------------

const caster = new Raycaster();
let pointer = null;
byId("canvas").addEventListener("pointermove", (event) => {
  if (!pointer) requestAnimationFrame(point);
  pointer = new Vector2(event.offsetX, event.offsetY);
});
byId("canvas").addEventListener("pointerleave", () => { byId("pointed").textContent = ""; });

function imageValue(view, image, place) {
  const pixels = picture(image.png).pixels;
  const [d, u, v] = view.axes.map((axis) => new Vector3(...axis));
  let along = place.dot(d);
  if (view.slant_range_m > 0) along = Math.hypot(along + view.slant_range_m, place.dot(v)) - view.slant_range_m;
  const row = Math.floor(along / view.spacing_m[0] + view.shape[0] / 2 + view.shift_px[0]);
  const col = Math.floor(place.dot(u) / view.spacing_m[1] + view.shape[1] / 2 + view.shift_px[1]);
  if (!pixels || row < 0 || col < 0 || row >= view.shape[0] || col >= view.shape[1]) return "outside the image";
  const at = 4 * (row * view.shape[1] + col);
  const where = `row ${row}, column ${col}`;
  if (pixels.data[at + 3] === 0) return `${where}: nothing`;
  return `${where}: ${decibels(image.scale, pixels.data[at] / 255).toFixed(1)} dB`;
}

function point() {
  const { clientWidth: width, clientHeight: height } = byId("canvas");
  caster.setFromCamera(new Vector2((2 * pointer.x) / width - 1, 1 - (2 * pointer.y) / height), camera);
  pointer = null;
  const [hit] = caster.intersectObject(state.mesh);
  if (!hit) {
    byId("pointed").textContent = "";
    return;
  }
  const { x, y, z } = hit.point;
  const corner = hit.face.a;
  const said = [`east ${x.toFixed(2)}, north ${y.toFixed(2)}, up ${z.toFixed(2)} m`];
  said.push(...state.groups.map((one) => `${one.label} ${one.names[one.index[corner]]}`));
  const quantity = byId("quantity").value;
  const parameter = state.parameters.find((one) => one.label === quantity);
  const own = parameter?.values[corner];
  if (parameter) said.push(`${quantity} ${Number.isNaN(own) ? "none" : number(own)}`);
  const image = chosenView()?.images[quantity];
  if (image) said.push(imageValue(chosenView(), image, hit.point));
  byId("pointed").textContent = said.join(" · ");
}

choose(state);
fit();
lookFrom(HOME, 4.4);
