// Answers the viewer's page inside the page itself: the scene, lenses and photographs of this file, drawn
// by the C++ core as WebAssembly in workers and, while the eye moves, by WebGL 2 where there is one. What
// gsut view answers over HTTP, with the same names.
"use strict";
// Threads beyond which copies of the scene cost more than they gain.
const MOST_WORKERS = 4;
// Resized lenses that are kept: the sizes of moving frames of a few lenses.
const KEPT_LENSES = 64;
// Alpha above which a pixel shows something.
const SEEN = 0.5;
// Percentiles of the distances that the colours span.
const RANGE = [0.02, 0.98];
// Most pixels along a side of a lens from a file.
const MOST_SIDE = 65536;
// Columns at which the field of view is measured, and bisections of a focal length.
const FIELD_SAMPLES = 129, SEARCH_STEPS = 60;

// --- the scene: SPZ of version 3, as page_file.py packs it ------------------------------------------
function readScene(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const [magic, version, size] = [0, 4, 8].map((at) => (bytes.length < 16 ? 0 : view.getUint32(at, true)));
  const degree = bytes[12], step = 2 ** -bytes[13], coefficients = (degree + 1) ** 2;
  if (magic !== 0x47415047 || version !== 3 || degree > 3 || bytes.length !== 16 + size * (20 + 3 * (coefficients - 1))) {
    throw new Error("this file is damaged: its Gaussians are not those that gsut wrote; copy it again");
  }
  let at = 16;
  const take = (each) => bytes.subarray(at, (at += each * size));
  const planes = take(9), alphas = take(1), colors = take(3), scales = take(3), packed = take(4), rest = take(3 * (coefficients - 1));
  const means = new Float32Array(3 * size), quats = new Float32Array(4 * size), logits = new Float32Array(size), sh = new Float32Array(3 * coefficients * size);
  for (let k = 0; k < 3; k++) {
    for (let i = 0, sum = 0; i < size; i++) {
      const word = planes[3 * k * size + i] | (planes[(3 * k + 1) * size + i] << 8) | (planes[(3 * k + 2) * size + i] << 16);
      sum += (word >>> 1) ^ -(word & 1);
      means[3 * i + k] = sum * step;
    }
  }
  for (let i = 0; i < size; i++) {
    const opacity = alphas[i] / 255, logit = Math.log(opacity) - Math.log1p(-opacity);
    logits[i] = Math.max(-20, Math.min(20, logit));
    const word = (packed[i] | (packed[size + i] << 8) | (packed[2 * size + i] << 16) | (packed[3 * size + i] << 24)) >>> 0;
    const largest = word >>> 30, xyzw = [0, 0, 0, 0];
    let sum = 0, shift = 20;
    for (let k = 0; k < 4; k++) {
      if (k === largest) continue;
      const value = word >>> shift, others = ((value & 511) / 511) * (value & 512 ? -1 : 1) / Math.SQRT2;
      xyzw[k] = others;
      sum += others * others;
      shift -= 10;
    }
    xyzw[largest] = Math.sqrt(Math.max(0, 1 - sum));
    quats.set([xyzw[3], xyzw[0], xyzw[1], xyzw[2]], 4 * i);
    for (let k = 0; k < 3; k++) sh[3 * coefficients * i + k] = toFirstHarmonic(colors[3 * i + k]);
    const from = 3 * (coefficients - 1);
    for (let k = 0; k < from; k++) sh[3 * coefficients * i + 3 + k] = (rest[from * i + k] - 128) / 128;
  }
  return { size, coefficients, stored: { colors, rest }, parts: [means, quats, Float32Array.from({ length: 3 * size }, (_, at) => scales[(at % 3) * size + Math.floor(at / 3)] / 16 - 10), logits, sh] };
}

const toFirstHarmonic = (stored) => (stored / 255 - 0.5) / 0.15;

// --- poses: 4 x 4 in rows -------------------------------------------------------------------------
const multiply = (a, b) => Array.from({ length: 16 }, (_, i) => [0, 1, 2, 3].reduce((sum, k) => sum + a[4 * (i >> 2) + k] * b[4 * k + (i & 3)], 0));
const invert = (m) => {
  const t = [m[3], m[7], m[11]], out = [m[0], m[4], m[8], 0, m[1], m[5], m[9], 0, m[2], m[6], m[10], 0, 0, 0, 0, 1];
  for (let k = 0; k < 3; k++) out[4 * k + 3] = -(out[4 * k] * t[0] + out[4 * k + 1] * t[1] + out[4 * k + 2] * t[2]);
  return out;
};
const placeAbout = (m, origin) => m.map((value, i) => (i % 4 === 3 && i < 12 ? value + m[i - 3] * origin[0] + m[i - 2] * origin[1] + m[i - 1] * origin[2] : value));

function asStored({ turns = 0, ...values }) { // a request in the pose and size of the lens' own pixels
  const [x, y, rest] = [values.pose.slice(0, 4), values.pose.slice(4, 8), values.pose.slice(8)], minus = (row) => row.map((value) => -value);
  const [first, second] = [[x, y], [y, minus(x)], [minus(x), minus(y)], [minus(y), x]][turns];
  const size = turns % 2 ? { width: values.height, height: values.width } : {};
  return { ...values, pose: [...first, ...second, ...rest], ...size };
}
const turnedBack = ([x, y], width, height, turns) => [[x, y], [y, height - x], [width - x, height - y], [width - y, x]][turns]; // a pixel of the page's picture in the lens' own
function turnedPicture(picture, turns) { // clockwise, by quarter turns
  const { width, height } = picture, size = turns % 2 ? { width: height, height: width } : { width, height };
  const canvas = Object.assign(document.createElement("canvas"), size), brush = canvas.getContext("2d");
  brush.translate(size.width / 2, size.height / 2);
  brush.rotate(turns * Math.PI / 2);
  brush.drawImage(picture, -width / 2, -height / 2);
  return canvas;
}

function readLensFile(core, name, text) { // gsut's format or mrcal's; an impossible lens is refused by the core
  let found = null;
  if (/\.cameramodel$/i.test(name)) {
    const camera = core.readCamera(text, name);
    try { found = core.describeCamera(camera); } finally { core.releaseCamera(camera); }
    return (({ model, params, width, height }) => ({ model, params, width, height, valid_field_angle: null }))(found);
  }
  try { found = JSON.parse(text); } catch { /* refused below */ }
  const { model, params, width, height, valid_field_angle = null } = found ?? {};
  const sides = [width, height].every((side) => Number.isInteger(side) && side > 0 && side <= MOST_SIDE);
  if (typeof model !== "string" || !sides || !Array.isArray(params) || !params.every(Number.isFinite)) {
    throw new Error(`${name}: a page reads gsut's lens files (.lens.json) and mrcal's; 'gsut camera convert' writes either`);
  }
  return { model, params, width, height, valid_field_angle };
}

class PageServer {
  constructor() {
    this.lenses = []; // by number: model, params, width, height, valid_field_angle
    this.resized = new Map(); // text of a lens' number and a size -> the lens at that size
    this.central = new Map(); // model -> whether its rays meet in one point
    this.ready = this.start();
  }

  async start() {
    const [content, bytes, packed] = await Promise.all(["content", "core", "scene"].map(unpack));
    this.content = JSON.parse(new TextDecoder().decode(content));
    this.gaussians = readScene(packed);
    this.core = await Core.load(bytes);
    this.models = this.core.models();
    this.lenses = [...this.content.lenses];
    const code = URL.createObjectURL(new Blob([texts["exact/core.js"], texts["exact/worker.js"]], { type: "text/javascript" }));
    const count = Math.max(1, Math.min(MOST_WORKERS, navigator.hardwareConcurrency || 1));
    this.workers = Array.from({ length: count }, () => {
      const worker = new Worker(code), waiting = new Map();
      let number = 0;
      worker.onmessage = ({ data: { id, value, error } }) => {
        const [resolve, reject] = waiting.get(id);
        waiting.delete(id);
        error === undefined ? resolve(value) : reject(new Error(error));
      };
      worker.onerror = (event) => waiting.forEach(([, reject]) => reject(new Error(`a thread of this page stopped: ${event.message}`)));
      const send = (task, values) => new Promise((resolve, reject) => { waiting.set(++number, [resolve, reject]); worker.postMessage({ id: number, task, values }); });
      return { send, share: 1 / count };
    });
    const { size, coefficients, parts } = this.gaussians;
    await Promise.all(this.workers.map(({ send }) => send("start", { bytes, size, coefficients, parts })));
    this.moving = this.findMoving();
  }

  findMoving() { // null where there is no WebGL 2: the workers draw small frames
    try { return MovingPicture.find(texts["exact/moving.glsl"], texts["exact/order.js"], this.gaussians); } catch (error) {
      console.info(`a moving picture is small: ${error.message}`);
      return null;
    }
  }
  isSmooth({ mode, lens }) { return Boolean(this.moving) && !this.moving.lost && mode === "color" && this.isCentral(this.lenses[lens]); }
  async drawMoving(values, turns) { // by WebGL 2
    const { width, height } = values, lens = this.lenses[values.lens], began = performance.now();
    let picture = await this.moving.draw(this.core, lens, placeAbout(values.pose, this.content.origin), width, height, this.content.background);
    if (values.marks?.length) {
      picture = turnedPicture(picture, 0);
      this.drawMarks(picture.getContext("2d"), this.resize(values.lens, width, height), values);
    }
    return { picture: turns ? turnedPicture(picture, turns) : picture, span: null, way: `${Math.round(performance.now() - began)} ms, WebGL 2` };
  }

  isCentral(lens) {
    const known = this.central.get(lens.model) ?? this.borrow(lens, (camera) => this.core.describeCamera(camera).central);
    this.central.set(lens.model, known);
    return known;
  }

  async ask(name, values) {
    await this.ready;
    if (name === "scene") return { ...this.content.scene, lenses: this.lenses.map((_, number) => this.describe(number)), models: Object.fromEntries(Object.entries(this.models).map(([model, { names }]) => [model, names])), num_gaussians: this.gaussians.size };
    if (name === "lens") return this.describe(this.lenses.push(await this.makeLens(values)) - 1);
    if (name === "pick") return this.pick(values);
    throw new Error(`${name} needs gsut view`);
  }
  photo(view) { return this.content.photographs[view]; }
  async file(name, values) {
    if (name === "camera") {
      const { turns } = values, poses = values.poses.map((pose) => asStored({ ...values, pose })), rows = (m) => [0, 4, 8, 12].map((k) => m.slice(k, k + 4));
      const { turns: _, ...lens } = this.resize(values.lens, poses[0].width, poses[0].height);
      return new Blob([JSON.stringify({ camera_from_world: poses.map(({ pose }) => rows(pose)), lens, ...(turns ? { turns } : {}) }) + "\n"], { type: "application/json" });
    }
    const { picture } = await this.frame(values);
    return new Promise((done) => picture.toBlob(done, "image/png"));
  }

  // --- lenses ---
  borrow(lens, work) { // work(handle) with a camera of the core
    const camera = this.core.makeCamera(lens);
    try { return work(camera); } finally { this.core.releaseCamera(camera); }
  }
  resize(number, width, height) {
    const lens = this.lenses[number];
    if (lens.width === width && lens.height === height) return lens;
    const key = `${number} ${width} ${height}`;
    if (this.resized.has(key)) return this.resized.get(key);
    if (this.resized.size >= KEPT_LENSES) this.resized.clear();
    const found = this.borrow(lens, (camera) => {
      const resized = this.core.resizeCamera(camera, width, height);
      try { return { ...lens, width, height, params: this.core.describeCamera(resized).params }; } finally { this.core.releaseCamera(resized); }
    });
    this.resized.set(key, found);
    return found;
  }
  fieldOf(lens) { // degrees across the middle row, or null
    return this.borrow(lens, (camera) => {
      const pixels = Array.from({ length: FIELD_SAMPLES }, (_, k) => [lens.width * k / (FIELD_SAMPLES - 1), lens.height / 2]).flat();
      const { rays, valid } = this.core.unproject(camera, pixels), seen = [];
      valid.forEach((ok, k) => ok && seen.push(rays.subarray(3 * k, 3 * k + 3)));
      if (seen.length < 2) return null;
      return seen.slice(1).reduce((sum, ray, k) => sum + Math.acos(Math.max(-1, Math.min(1, ray[0] * seen[k][0] + ray[1] * seen[k][1] + ray[2] * seen[k][2]))), 0) * 180 / Math.PI;
    });
  }
  describe(number) {
    const lens = this.lenses[number], names = this.models[lens.model].names.split(" ");
    const described = this.borrow(lens, (camera) => {
      const { rays, valid } = this.core.unproject(camera, [lens.width / 2 - 0.5, lens.height / 2, lens.width / 2 + 0.5, lens.height / 2]);
      const apart = Math.hypot(rays[1] * rays[5] - rays[2] * rays[4], rays[2] * rays[3] - rays[0] * rays[5], rays[0] * rays[4] - rays[1] * rays[3]);
      return { max_angle: this.core.describeCamera(camera).max_angle * 180 / Math.PI, radians_per_pixel: (valid[0] && valid[1] && apart) || 1 / lens.width };
    });
    return { id: number, ...lens, sliders: [], field_of_view: this.fieldOf(lens), can_zoom: names.includes("fx") && names.includes("fy"), ...described };
  }
  async makeLens(values) {
    let lens = this.lenses[values.id ?? 0];
    if (values.model) lens = (({ params, width, height }) => ({ model: values.model, params, width, height, valid_field_angle: null }))(this.models[values.model]);
    if (values.name) {
      lens = readLensFile(this.core, values.name, new TextDecoder().decode(Uint8Array.from(atob(values.base64), (letter) => letter.charCodeAt(0))));
    }
    const names = this.models[lens.model].names.split(" "), at = names.indexOf("cx");
    if (values.fit && at >= 0 && !this.models[lens.model].has_table) {
      const wide = Math.max(1, Math.round(lens.height * values.fit[0] / values.fit[1]));
      lens = { ...lens, width: wide, params: lens.params.map((value, k) => (k === at ? value + (wide - lens.width) / 2 : value)) };
    }
    if (values.field_of_view) lens = this.widen(lens, values.field_of_view);
    this.borrow(lens, () => {}); // an impossible lens is refused here
    return lens;
  }
  widen(lens, degrees) { // scales the focal lengths so that the image spans this field
    const names = this.models[lens.model].names.split(" ");
    const scaled = (log) => ({ ...lens, params: lens.params.map((value, k) => (names[k] === "fx" || names[k] === "fy" ? value * Math.exp(log) : value)) });
    let low = Math.log(1e-3), high = Math.log(1e3);
    for (let k = 0; k < SEARCH_STEPS; k++) {
      const middle = (low + high) / 2, across = this.fieldOf(scaled(middle));
      if (across === null || across < degrees) high = middle;
      else low = middle;
    }
    const found = scaled((low + high) / 2), across = this.fieldOf(found);
    if (across === null || Math.abs(across - degrees) > 0.01 * degrees + 0.1) throw new Error(`a ${lens.model} lens cannot span ${degrees} degrees`);
    return found;
  }

  // --- frames ---
  place({ pose, shutter }) { // where the camera is while the image is read
    const origin = this.content.origin, motion = shutter === null || shutter === undefined ? null : this.content.motions[shutter];
    if (!motion) return { start: placeAbout(pose, origin) };
    const same = motion.pose.every((value, k) => value === pose[k]), moved = multiply(invert(motion.pose), pose);
    const [start, end] = [motion.start, motion.end].map((edge) => placeAbout(same ? edge : multiply(edge, moved), origin));
    return { start, end, shutter: motion.direction };
  }
  inTurn(work) { return (this.turn = (this.turn ?? Promise.resolve()).catch(() => {}).then(work)); }
  draw(values, depth) { return this.inTurn(() => this.drawRows(values, depth)); }
  async drawRows(values, depth) { // all rows by all workers, as floats
    const lens = this.resize(values.lens, values.width, values.height), { width, height } = lens, rows = Math.ceil(height / 16);
    const background = this.content.background ?? [0, 0, 0], alpha = depth || !this.content.background;
    const job = { lens, background, alpha, depth, ...this.place(values) };
    const whole = Object.assign(await this.drawOnWorkers(lens, job, rows), { width, height, lens });
    if (!this.content.background) this.core.fillSurroundings(whole);
    return whole;
  }
  async drawOnWorkers(lens, job, rows) {
    const { width, height } = lens, { alpha, depth } = job;
    let edge = 0, sum = 0;
    const parts = this.workers.map(({ share }, k) => {
      const begin = edge;
      sum += share;
      edge = k === this.workers.length - 1 ? rows : Math.round(rows * sum);
      return [begin, edge];
    });
    const drawn = await Promise.all(parts.map((range, k) => (range[0] < range[1] ? this.workers[k].send("draw", { ...job, rows: range }) : null)));
    const join = (name, channels, Kind = Float32Array) => {
      const out = new Kind(channels * width * height);
      for (const piece of drawn) if (piece) out.set(piece[name], channels * width * Math.min(height, 16 * piece.rows[0]));
      return out;
    };
    this.balance(drawn);
    return { image: join("image", 3), valid: join("valid", 1, Uint8Array), alpha: alpha ? join("alpha", 1) : null, depth: depth ? join("depth", 1) : null };
  }
  balance(drawn) { // shares of the rows by how fast each worker was, halfway at a time
    const speeds = drawn.map((piece, k) => (piece ? this.workers[k].share / Math.max(1, piece.ms) : 0)), sum = speeds.reduce((a, b) => a + b);
    this.workers.forEach((worker, k) => (worker.share = 0.5 * worker.share + 0.5 * Math.max(0.05, speeds[k] / sum)));
    const all = this.workers.reduce((total, { share }) => total + share, 0);
    this.workers.forEach((worker) => (worker.share /= all));
  }
  async frame(wish) {
    await this.ready;
    const values = asStored(wish), turns = wish.turns ?? 0;
    if (values.moving && this.isSmooth(values)) return this.drawMoving(values, turns);
    const began = performance.now(), drawn = await this.draw(values, values.mode === "distance"), { width, height } = drawn;
    const data = new ImageData(width, height), out = data.data;
    const span = values.mode === "distance" ? this.colorDistances(drawn, out) : null;
    if (!span) {
      for (let i = 0; i < width * height; i++) for (let k = 0; k < 3; k++) out[4 * i + k] = 255 * drawn.image[3 * i + k];
    }
    for (let i = 3; i < out.length; i += 4) out[i] = 255;
    const picture = Object.assign(document.createElement("canvas"), { width, height }), brush = picture.getContext("2d");
    brush.putImageData(data, 0, 0);
    if (values.marks?.length) this.drawMarks(brush, drawn.lens, values);
    const by = `WebAssembly on ${this.workers.length} thread${this.workers.length > 1 ? "s" : ""}`;
    return { picture: turns ? turnedPicture(picture, turns) : picture, span, way: `${Math.round(performance.now() - began)} ms, ${by}` };
  }
  colorDistances({ alpha, depth }, out) {
    const distance = depth.map((value, i) => (alpha[i] > SEEN ? value / alpha[i] : NaN)), known = distance.filter(Number.isFinite).sort();
    const pick = (share) => known[Math.round(share * (known.length - 1))];
    const near = known.length ? pick(RANGE[0]) : 1, far = Math.max(known.length ? pick(RANGE[1]) : 2, near * 1.001 + 1e-9);
    distance.forEach((value, i) => {
      const at = 3 * Math.max(0, Math.min(255, Math.round(255 * (1 / value - 1 / far) / (1 / near - 1 / far))));
      if (value === value) for (let k = 0; k < 3; k++) out[4 * i + k] = this.content.colors[at + k];
    });
    return `${near} ${far}`;
  }
  drawMarks(brush, lens, { pose, marks }) {
    const inCamera = (p) => [0, 1, 2].map((k) => pose[4 * k] * p[0] + pose[4 * k + 1] * p[1] + pose[4 * k + 2] * p[2] + pose[4 * k + 3]);
    const points = marks.length === 2 ? Array.from({ length: 41 }, (_, k) => marks[0].map((a, i) => a + (marks[1][i] - a) * k / 40)) : marks;
    const { pixels, valid } = this.borrow(lens, (camera) => this.core.project(camera, points.flatMap(inCamera)));
    brush.strokeStyle = "#34d399";
    brush.lineWidth = 2;
    brush.beginPath();
    points.forEach((_, k) => valid[k] && brush[k && valid[k - 1] ? "lineTo" : "moveTo"](pixels[2 * k], pixels[2 * k + 1]));
    brush.stroke();
    for (const k of marks.length === 2 ? [0, 40] : marks.keys()) {
      if (!valid[k]) continue;
      brush.beginPath();
      brush.arc(pixels[2 * k], pixels[2 * k + 1], 5, 0, 7);
      brush.stroke();
    }
  }
  async pick({ frame: wish, pixel: picked }) {
    const frame = asStored(wish);
    const pixel = turnedBack(picked, frame.width, frame.height, wish.turns ?? 0);
    const { width, height, lens, alpha, depth } = await this.draw(frame, true);
    const at = Math.min(height - 1, Math.max(0, Math.floor(pixel[1]))) * width + Math.min(width - 1, Math.max(0, Math.floor(pixel[0])));
    const { origins, rays, valid } = this.borrow(lens, (camera) => this.core.unproject(camera, pixel));
    if (!valid[0] || alpha[at] < SEEN) return { point: null };
    const back = invert(frame.pose), p = [0, 1, 2].map((k) => origins[k] + rays[k] * depth[at] / alpha[at]);
    const point = [0, 1, 2].map((k) => back[4 * k] * p[0] + back[4 * k + 1] * p[1] + back[4 * k + 2] * p[2] + back[4 * k + 3]);
    return { point, in_dataset: point.map((value, k) => value + this.content.offset[k]), distance: Math.hypot(...p) };
  }
}
window.pageServer = new PageServer();
