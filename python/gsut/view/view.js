// The page of gsut view: moves through a scene and requests one frame at a time, of the newest pose.
"use strict";

const base = location.pathname.replace(/[^/]*$/, "");
const $ = (id) => document.getElementById(id);
const MODE_NAMES = { color: "Colour", distance: "Distance", normal: "Normals", alpha: "Alpha", centers: "Centres", error: "Error" };
const COMPARE_NAMES = { render: "Render", photo: "Photo", fade: "Fade", wipe: "Wipe", flicker: "Flicker" };
const LAYER_NAMES = { cameras: "Cameras", points: "Points", domain: "No ray" };
// Number of Gaussians above which these, not the pixels, decide how long a frame takes.
const LARGE = 200000;
// Size of a frame while moving, by level, relative to the shown size. The picture shrinks first;
// Gaussians are left out only if that is not enough. smooth: of a page that moves by WebGL.
const SCALES = { small: [0.2, 0.25, 0.35, 0.5, 0.7, 1], large: [0.35, 0.5, 0.5, 0.5, 0.7, 1], smooth: [0.35, 0.5, 0.7, 1, 1.4, 2] };
// Share of the Gaussians that a frame while moving is drawn from, by level.
const SHARES = { small: [1, 1, 1, 1, 1, 1], large: [0.25, 0.25, 0.5, 1, 1, 1], smooth: [1, 1, 1, 1, 1, 1] };
// Milliseconds of a frame above which the level falls.
const SLOW_MS = { small: 60, large: 60, smooth: 33 };
// Milliseconds of a frame below which the level rises, unless the next one is known to be slow.
const FAST_MS = { small: 50, large: 50, smooth: 24 };
// Milliseconds of a frame above which Gaussians are left out: ten frames a second.
const SLOWEST_MS = 100;
// Milliseconds after the last movement until a frame of full quality is requested.
const REST_MS = 140;
// Longer side in pixels below which a frame while moving is not drawn: the Gaussians take the time there.
const LEAST_SIDE = 160;
// Quality of the JPEG of a frame while moving.
const MOVING_QUALITY = 75;
// Most pixels of a frame, unless it is lossless.
const MOST_PIXELS = 3e6;
// Pixels of a frame above which gsut view draws smaller ones beside it.
const LARGE_FRAME = 1920 * 1080;
// Field of view in degrees of the pinhole that fills the window.
const PLAIN_FIELD = 80;

let scene; // as the server describes it
let lens; // the lens in use, described
const state = {
  eye: { R: null, c: null }, // world_from_camera: columns right, down, forward; centre
  exact: null, // a photograph's own pose, bit for bit, until the eye moves
  mode: "color", compare: "render", view: null, shutter: null, layers: new Set(),
  marks: [], keys: [], navigation: "walk", pivot: null, up: null, measuring: false, lossless: false,
};

// --- small linear algebra: vectors of 3, matrices of 9 in rows ---------------------------------
const add = (a, b, s = 1) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const norm = (a) => Math.hypot(...a);
const unit = (a) => { const n = norm(a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };
const column = (R, k) => [R[k], R[3 + k], R[6 + k]];
const columns = (x, y, z) => [x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]];
const turned = (v, axis, angle) => { // Rodrigues
  const c = Math.cos(angle), s = Math.sin(angle);
  return add(add([v[0] * c, v[1] * c, v[2] * c], cross(axis, v), s), axis, dot(axis, v) * (1 - c));
};
const rigid = (R) => { // the rotation next to R
  const z = unit(column(R, 2)), x = unit(add(column(R, 0), z, -dot(column(R, 0), z)));
  return columns(x, cross(z, x), z);
};
const turn = (R, axis, angle) => rigid(columns(...[0, 1, 2].map((k) => turned(column(R, k), axis, angle))));

// A lens as its pictures are shown: upright, after quarter turns clockwise.
const shownAs = (described, turns = 0) => ({ ...described, turns, ...(turns % 2 ? { width: described.height, height: described.width } : {}) });

function eyeOf(pose) { // of camera_from_world, 16 numbers
  const R = [pose[0], pose[4], pose[8], pose[1], pose[5], pose[9], pose[2], pose[6], pose[10]];
  const t = [pose[3], pose[7], pose[11]];
  return { R, c: [0, 1, 2].map((i) => -dot(R.slice(3 * i, 3 * i + 3), t)) };
}
function poseOf({ R, c }) {
  const rows = [0, 1, 2].map((k) => column(R, k));
  return [...rows.flatMap((r) => [...r, -dot(r, c)]), 0, 0, 0, 1];
}

// --- the server ----------------------------------------------------------------------------------
async function call(name, values) {
  let reply;
  try {
    reply = await fetch(base + name, values === undefined ? {} : { method: "POST", body: JSON.stringify(values) });
  } catch {
    throw new Error("gsut view is not running any more; start it again and open the address that it prints");
  }
  if (!reply.ok) throw new Error((await reply.json()).error);
  return reply;
}
const http = {
  ask: async (name, values) => (await call(name, values)).json(),
  file: async (name, values) => (await call(name, values)).blob(),
  photo: (view, side, mask = false) => `${base}photo?${encodeURIComponent(JSON.stringify({ view, side, mask }))}`,
  async frame(values) {
    const reply = await call("frame", values);
    const picture = await createImageBitmap(await reply.blob(), { colorSpaceConversion: "none", premultiplyAlpha: "none" });
    return { picture, span: reply.headers.get("X-Span") };
  },
};
// Who answers: gsut view or, in a page of one file, the code beside this one.
const server = window.pageServer ?? http;
const ask = (name, values) => server.ask(name, values);

let toastTimer;
function toast(text, seconds = 4) {
  $("toast").textContent = text;
  $("toast").hidden = !text;
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => ($("toast").hidden = true), 1000 * seconds);
}
const guarded = (action) => async (...event) => { try { await action(...event); } catch (error) { toast(error.message, 8); } };

// --- frames --------------------------------------------------------------------------------------
// Weight of the newest frame in what a level takes, and what is left a frame of what another level took:
// a level that was slow is tried again some seconds later.
const NEWEST = 0.3, FADE = 0.995;
let wanted = false, busy = false, lastMove = -1e9, level = 3, restTimer, shown = 0, drawnTimes = [];
const took = []; // milliseconds of a frame by level; 0: its first one, which also makes the camera, is to come

const isSmooth = () => Boolean(server.isSmooth?.({ mode: state.mode, lens: lens.id }));
const kind = () => (isSmooth() ? "smooth" : scene.num_gaussians > LARGE ? "large" : "small");
function size() { // of the picture on the page, CSS pixels
  const area = $("stage").getBoundingClientRect(), shape = lens.width / lens.height;
  const width = Math.max(16, Math.floor(Math.min(area.width, area.height * shape)));
  return [width, Math.max(12, Math.round(width / shape))];
}
function request(moving) {
  let [width, height] = size();
  if (state.lossless && !moving) [width, height] = [lens.width, lens.height];
  else {
    const room = Math.sqrt(Math.min(1, MOST_PIXELS / (width * height * devicePixelRatio ** 2)));
    const least = Math.min(1, LEAST_SIDE / Math.max(width, height));
    const factor = moving ? Math.min(devicePixelRatio, Math.max(least, SCALES[kind()][level])) : devicePixelRatio * room;
    [width, height] = [width, height].map((side) => Math.max(8, Math.round(side * factor)));
  }
  const mode = state.mode === "error" && state.view === null ? "color" : state.mode;
  const rolling = state.shutter !== null && $("rolling").checked && !edits.on ? state.shutter : null; // a region has one pose
  return {
    pose: state.exact ?? poseOf(state.eye), lens: lens.id, turns: lens.turns, width, height, mode, view: state.view, shutter: rolling,
    layers: [...state.layers], marks: state.marks, quality: moving ? MOVING_QUALITY : state.lossless ? null : 92,
    edits: edits.key, moving, share: moving ? SHARES[kind()][level] : 1,
  };
}
function redraw(moved = true) {
  if (!lens) return;
  wanted = true;
  if (moved) {
    lastMove = performance.now();
    interrupt();
  }
  if (!busy) frame();
}
let resting = Promise.resolve(), interrupt = () => {};
function drawAtRest(values) { // null as soon as the eye moves; frames at rest are drawn in turn
  const drawn = (resting = resting.catch(() => {}).then(() => (wanted ? null : server.frame(values))));
  const beside = isSmooth() || (server === http && values.width * values.height > LARGE_FRAME);
  return beside ? Promise.race([drawn, new Promise((done) => (interrupt = () => done(null)))]) : drawn;
}
async function frame() {
  busy = true;
  while (wanted) {
    wanted = false;
    const moving = performance.now() - lastMove < REST_MS, values = request(moving), began = performance.now();
    try {
      const drawn = await (moving ? server.frame(values) : drawAtRest(values));
      if (drawn) show(drawn.picture, values, drawn.span, drawn.way);
    } catch (error) {
      toast(error.message, 8);
      await new Promise((done) => setTimeout(done, 500));
    }
    if (moving) {
      chooseLevel(performance.now() - began);
      clearTimeout(restTimer);
      restTimer = setTimeout(() => redraw(false), REST_MS + 20);
    }
  }
  busy = false;
}
function chooseLevel(ms) { // of the next moving frame, by the milliseconds of the last one
  if (!took[level]) { took[level] = took[level] === 0 ? ms : 0; return; }
  const slow = SLOW_MS[kind()], fast = FAST_MS[kind()], shares = SHARES[kind()], slowest = (k) => (shares[k - 1] < shares[k] ? SLOWEST_MS : slow);
  took.forEach((before, k) => (took[k] = k === level ? before + NEWEST * (Math.min(ms, 2 * slow) - before) : FADE * before));
  if (level > 0 && took[level] > slowest(level)) level--;
  else if (level < shares.length - 1 && took[level] < fast && !(took[level + 1] > fast)) level++;
}
function show(picture, values, span, way) {
  const canvas = $("canvas");
  if (canvas.width !== picture.width || canvas.height !== picture.height) [canvas.width, canvas.height] = [picture.width, picture.height];
  canvas.getContext("2d").drawImage(picture, 0, 0);
  picture.close?.();
  const now = performance.now();
  drawnTimes = [...drawnTimes.filter((time) => now - time < 1000), now];
  $("pace").textContent = `${values.quality === MOVING_QUALITY && drawnTimes.length > 1 ? drawnTimes.length + " frames/s · " : ""}${values.width} × ${values.height}${values.quality === null ? " exact" : ""}${way ? " · " + way : ""}`;
  $("legend").hidden = !span;
  if (span) {
    const [low, high] = span.split(" ").map(Number), error = values.mode === "error";
    $("legend").classList.toggle("error-map", error);
    $("legend-low").textContent = error ? "0" : format(low);
    $("legend-high").textContent = error ? `≥ ${high} of full scale` : format(high);
  }
  document.body.dataset.frames = ++shown;
  document.body.dataset.frame = JSON.stringify({ width: values.width, height: values.height, lossless: values.quality === null, view: values.view, mode: values.mode });
}
const format = (x) => (Math.abs(x) >= 1e4 || (x && Math.abs(x) < 1e-2) ? x.toExponential(2) : +x.toPrecision(4) + "");

// --- the eye -------------------------------------------------------------------------------------
function leavePhotograph() {
  if (state.view === null && !state.exact) return;
  state.exact = null;
  state.view = null;
  choosePhotograph(null);
}
function look(dx, dy) {
  const { eye } = state;
  leavePhotograph();
  eye.R = turn(turn(eye.R, state.up, -dx), column(eye.R, 0), dy);
  redraw();
}
function orbit(dx, dy) {
  const { eye, pivot } = state;
  leavePhotograph();
  for (const [axis, angle] of [[state.up, -dx], [column(eye.R, 0), dy]]) {
    eye.c = add(pivot, turned(add(eye.c, pivot, -1), axis, angle));
    eye.R = turn(eye.R, axis, angle);
  }
  redraw();
}
function move(right, up, forward) {
  const { eye } = state;
  leavePhotograph();
  eye.c = add(add(add(eye.c, column(eye.R, 0), right), column(eye.R, 1), -up), column(eye.R, 2), forward);
  redraw();
}
const step = () => scene.extent * 2 ** Number($("speed").value);
function dolly(amount) { // when orbiting: by a share of the way to the pivot
  const away = norm(add(state.pivot, state.eye.c, -1));
  move(0, 0, state.navigation === "orbit" ? away * (1 - Math.exp(-amount)) : amount * step() * 0.5);
}
function levelled() {
  const { eye } = state, z = column(eye.R, 2), x = cross(z, state.up);
  if (norm(x) < 1e-3) return;
  leavePhotograph();
  eye.R = columns(unit(x), cross(z, unit(x)), z);
  redraw();
}
let flight = 0;
function fly(eye, arrive, ms = 350, through = false) { // moves the eye smoothly to another pose, or at one pace through it
  const from = { R: [...state.eye.R], c: [...state.eye.c] }, began = performance.now(), mine = ++flight;
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches || document.hidden;
  const tick = () => {
    if (mine !== flight) return;
    const t = still ? 1 : Math.min(1, (performance.now() - began) / ms), s = through ? t : t * t * (3 - 2 * t);
    if (t >= 1) { Object.assign(state.eye, { R: [...eye.R], c: [...eye.c] }); arrive(); return; }
    state.eye.R = rigid(from.R.map((value, k) => value + s * (eye.R[k] - value)));
    state.eye.c = add(from.c, add(eye.c, from.c, -1), s);
    redraw();
    requestAnimationFrame(tick);
  };
  leavePhotograph();
  tick();
}

// --- pointers, wheel and keys --------------------------------------------------------------------
const pointers = new Map();
let gesture = 0, travelled = 0;
function pixelAngle() { return lens.radians_per_pixel * (lens.width / size()[0]); }
function onPointerDown(event) {
  $("canvas").focus({ preventScroll: true });
  flight++;
  if (beginStroke(event)) return;
  pointers.set(event.pointerId, event);
  $("canvas").setPointerCapture(event.pointerId);
  travelled = 0;
  gesture = event.button;
  $("canvas").classList.add("moving");
}
function onPointerMove(event) {
  if (continueStroke(event)) return;
  const before = pointers.get(event.pointerId);
  if (!before) return;
  const dx = event.clientX - before.clientX, dy = event.clientY - before.clientY;
  travelled += Math.abs(dx) + Math.abs(dy);
  if (travelled < 4) return;
  pointers.set(event.pointerId, event);
  const width = size()[0];
  if (pointers.size === 2) {
    const other = [...pointers.values()].find((p) => p.pointerId !== event.pointerId);
    const apart = (p) => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY);
    dolly(3 * Math.log(apart(event) / Math.max(1, apart(before))));
    move(-dx / width * step(), dy / width * step(), 0);
  } else if (gesture === 2 || gesture === 1) {
    const reach = state.navigation === "orbit" ? norm(add(state.pivot, state.eye.c, -1)) * pixelAngle() : step() * 1.5 / width;
    move(-dx * reach, dy * reach, 0);
  } else if (state.navigation === "orbit") orbit(dx * 2 * Math.PI / width, -dy * 2 * Math.PI / width);
  else look(-dx * pixelAngle(), dy * pixelAngle());
}
function onPointerUp(event) {
  if (finishStroke(event)) return;
  if (!pointers.delete(event.pointerId)) return;
  if (!pointers.size) $("canvas").classList.remove("moving");
  if (event.type === "pointerup" && travelled < 4 && state.measuring) guarded(measure)(event);
}
function pixelOf(event, values) {
  const box = $("canvas").getBoundingClientRect();
  return [(event.clientX - box.left) / box.width * values.width, (event.clientY - box.top) / box.height * values.height];
}
async function pick(event) {
  const values = request(false);
  return ask("pick", { frame: values, pixel: pixelOf(event, values) });
}
async function measure(event) {
  const found = await pick(event);
  if (!found.point) return toast("there is nothing to measure at this pixel");
  if (state.marks.length >= 2) state.marks = [];
  state.marks.push(found.point);
  const two = state.marks.length === 2;
  const place = found.in_dataset.map(format).join(", ");
  const text = two ? `${format(norm(add(state.marks[1], state.marks[0], -1)))} units apart` : `(${place}), ${format(found.distance)} units away; now the second point`;
  $("measure-text").textContent = $("measured").textContent = text;
  $("measured").hidden = false;
  redraw(false);
}
async function setPivot(event) {
  const found = await pick(event);
  if (!found.point) return toast("there is nothing to orbit at this pixel");
  state.pivot = found.point;
  choose("navigation", "orbit");
  const forward = unit(add(found.point, state.eye.c, -1)), right = unit(cross(forward, state.up));
  fly({ R: columns(right, cross(forward, right), forward), c: state.eye.c }, () => redraw());
}

const held = new Set();
const WALK = { KeyW: [0, 0, 1], KeyS: [0, 0, -1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyQ: [0, -1, 0], KeyE: [0, 1, 0] };
const LOOK = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
let clock = 0;
function walk(now) {
  if (!held.size) return;
  const seconds = Math.min(0.1, (now - clock) / 1000);
  clock = now;
  const fast = held.has("ShiftLeft") || held.has("ShiftRight") ? 4 : 1, way = [0, 0, 0], angle = [0, 0];
  for (const key of held) {
    WALK[key]?.forEach((value, k) => (way[k] += value));
    LOOK[key]?.forEach((value, k) => (angle[k] += value));
  }
  const reach = 0.4 * step() * fast * seconds, pace = 0.9 * seconds * Math.min(fast, 2);
  if (angle.some(Boolean)) (state.navigation === "orbit" ? orbit : look)(-angle[0] * pace, angle[1] * pace);
  if (way.some(Boolean)) move(way[0] * reach, way[1] * reach, way[2] * reach);
  requestAnimationFrame(walk);
}
const KEYS = {
  KeyO: () => choose("navigation", state.navigation === "walk" ? "orbit" : "walk"),
  KeyC: () => { const names = Object.keys(COMPARE_NAMES); choose("compare", names[(names.indexOf(state.compare) + 1) % names.length]); },
  KeyL: levelled, Home: () => $("home").click(), KeyK: () => $("key-add").click(), KeyM: () => $("measure").click(),
  KeyP: () => $("shot").click(), KeyT: () => $("panel-toggle").click(), KeyX: () => lossless(!state.lossless),
  BracketLeft: () => $("previous").click(), BracketRight: () => $("next").click(),
};
function onKeyDown(event) {
  if ($("help").open) return;
  if (/^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName) && !/^(checkbox|radio|range)$/.test(event.target.type)) return;
  if (/^(radio|range)$/.test(event.target.type) && /^(Arrow|Home)/.test(event.code)) return;
  if (onSelectKey(event) || event.ctrlKey || event.metaKey || event.altKey) return;
  const digit = /^Digit([1-6])$/.exec(event.code);
  if (event.key === "?") $("help").showModal();
  else if (digit) choose("modes", scene.modes[digit[1] - 1]);
  else if (event.code in KEYS) KEYS[event.code]();
  else if (event.code in WALK || event.code in LOOK || event.code.startsWith("Shift")) {
    flight++;
    if (!held.size) { clock = performance.now(); requestAnimationFrame(walk); }
    held.add(event.code);
    if (event.code in LOOK) event.preventDefault();
  }
}

// --- choices -------------------------------------------------------------------------------------
function choices(id, names, chosen, action) {
  for (const [value, text] of Object.entries(names)) {
    const label = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "radio", name: id, value, checked: value === chosen });
    input.addEventListener("change", () => action(value));
    label.append(input, text);
    $(id).append(label);
  }
}
function choose(id, value) {
  const input = document.querySelector(`input[name="${id}"][value="${value}"]`);
  if (!input || input.disabled) return;
  input.checked = true;
  input.dispatchEvent(new Event("change"));
}
function lossless(on) {
  state.lossless = $("lossless").checked = on;
  toast(on ? "exact pixels: size of the lens, lossless" : "size of the window");
  redraw(false);
}

// --- photographs ---------------------------------------------------------------------------------
let flicker;
function choosePhotograph(index) {
  state.view = index;
  for (const button of $("strip").children) button.setAttribute("aria-pressed", button.dataset.view === String(index));
  const view = index === null ? null : scene.views[index];
  $("photo-name").title = view ? view.name : "";
  $("photo-name").textContent = view ? view.name.replace(/^.*[/]/, "") + (view.held_out ? " (held out)" : "") : "none chosen";
  const error = document.querySelector("input[name=modes][value=error]");
  if (error) error.disabled = !view;
  $("photo").hidden = $("wipe").hidden = true;
  if (!view) return clearInterval(flicker);
  const photo = $("photo"), width = Math.round(size()[0] * devicePixelRatio);
  photo.onload = compare;
  photo.src = server.photo(index, Math.max(width, Math.round(width * view.height / view.width)), $("mask").checked);
}
function compare() {
  const { compare: how } = state, photo = $("photo"), there = state.view !== null;
  clearInterval(flicker);
  $("fade-row").hidden = how !== "fade" && how !== "wipe";
  photo.hidden = !there || how === "render";
  $("wipe").hidden = !there || how !== "wipe";
  photo.style.opacity = how === "fade" ? $("fade").value / 100 : 1;
  photo.style.clipPath = how === "wipe" ? `inset(0 ${100 - $("fade").value}% 0 0)` : "none";
  $("wipe").style.left = $("fade").value + "%";
  if (there && how === "flicker") flicker = setInterval(() => (photo.hidden = !photo.hidden), 600);
}
function goTo(index) {
  const count = scene.views.length;
  if (!count) return;
  index = (index + count) % count;
  const view = scene.views[index];
  const arrive = () => {
    state.exact = view.pose;
    state.shutter = view.rolling ? index : null;
    $("rolling-row").hidden = !view.rolling;
    choosePhotograph(index);
    history.replaceState(null, "", `#view=${index}`);
    const thumbnail = $("strip").querySelector(`[data-view="${index}"]`);
    thumbnail?.scrollIntoView({ block: "nearest", inline: "nearest" });
    redraw();
  };
  useLens(shownAs(scene.lenses[view.lens], view.turns));
  fly(eyeOf(view.pose), arrive);
}
// Milliseconds from one pose of a flight to the next.
const FLIGHT_MS = 1200;
function visit({ lens: number, turns, poses }) { // a view with a name: its first pose, then along its flight
  useLens(shownAs(scene.lenses[number], turns));
  const next = (k) => {
    redraw();
    if (k < poses.length) fly(eyeOf(poses[k]), () => next(k + 1), FLIGHT_MS, true);
  };
  fly(eyeOf(poses[0]), () => next(1));
}
function fillStrip() {
  $("strip").hidden = !scene.views.length && !scene.presets?.length;
  $("photo-section").hidden = !scene.views.length;
  for (const preset of scene.presets ?? []) {
    const button = Object.assign(document.createElement("button"), { className: "preset", textContent: preset.name });
    button.addEventListener("click", () => visit(preset));
    $("strip").append(button);
  }
  scene.views.forEach((view, index) => {
    const button = document.createElement("button"), picture = document.createElement("img");
    Object.assign(picture, { loading: "lazy", alt: "", width: Math.round(68 * view.width / view.height), height: 68, src: server.photo(index, 160) });
    Object.assign(button, { title: view.name, ariaLabel: view.name });
    button.dataset.view = index;
    button.setAttribute("aria-pressed", "false");
    button.classList.toggle("held-out", view.held_out);
    button.addEventListener("click", () => goTo(index));
    button.append(picture);
    $("strip").append(button);
  });
}

// --- lenses --------------------------------------------------------------------------------------
let reshape; // fits a lens that is not the dataset's to the window
function useLens(described, keepSliders = false) {
  const changed = !lens || lens.id !== described.id || lens.turns !== described.turns;
  lens = described;
  layout();
  if (!changed) return;
  const own = scene.lenses.some((each) => each.id === lens.id);
  if (own) reshape = null;
  $("lens").value = own ? `id:${lens.id}` : reshape?.model === "pinhole" && reshape.field_of_view ? "fill" : `model:${lens.model}`;
  const across = lens.field_of_view;
  $("lens-text").textContent = `${lens.model}, ${lens.width} × ${lens.height}` + (across ? `, ${Math.round(across)}° across` : "") + `, sees to ${Math.round(lens.max_angle)}° off its axis`;
  $("fov-row").hidden = !lens.can_zoom || !across;
  if (across && document.activeElement !== $("fov")) $("fov").value = across;
  $("fov-text").textContent = across ? Math.round(across) + "°" : "";
  $("lens-error").hidden = true;
  if (!keepSliders) fillSliders();
  redraw();
}
function fillSliders() {
  $("sliders").replaceChildren();
  $("sliders-box").hidden = !lens.sliders.length;
  lens.sliders.forEach((slider, index) => {
    const row = document.createElement("label"), range = document.createElement("input"), number = document.createElement("input");
    row.className = "slider";
    Object.assign(range, { type: "range", min: slider.low, max: slider.high, step: "any", value: slider.value });
    Object.assign(number, { type: "number", step: "any", value: +slider.value.toPrecision(7), ariaLabel: slider.name });
    const change = (from, to) => { to.value = +Number(from.value).toPrecision(7); paramsChanged(index, Number(from.value)); };
    range.addEventListener("input", () => change(range, number));
    number.addEventListener("change", () => change(number, range));
    row.append(slider.name, range, number);
    $("sliders").append(row);
  });
}
let lensBusy = false, lensNext = null;
async function makeLens(values, keepSliders = false) { // only the newest request counts
  lensNext = [values, keepSliders];
  if (lensBusy) return;
  lensBusy = true;
  while (lensNext) {
    const [wish, keep] = lensNext;
    lensNext = null;
    try {
      useLens(shownAs(await ask("lens", wish), wish.turns), keep);
      leavePhotograph();
    } catch (error) {
      $("lens-error").textContent = error.message;
      $("lens-error").hidden = false;
    }
  }
  lensBusy = false;
}
function windowShape() {
  const area = $("stage").getBoundingClientRect();
  return [Math.round(area.width), Math.round(area.height)];
}
function paramsChanged(index, value) {
  const params = [...lens.params];
  params[index] = value;
  reshape = null;
  makeLens({ id: lens.id, turns: lens.turns, params }, true);
}
const ownLens = (number) => shownAs(scene.lenses[number], scene.lenses[number].turns);
function fillLenses() {
  const group = (label, entries) => {
    const box = document.createElement("optgroup");
    box.label = label;
    for (const [value, text] of entries) box.append(new Option(text, value));
    $("lens").append(box);
  };
  group(scene.views.length ? "Lenses of the dataset" : "Pinhole", scene.lenses.map((_, k) => ownLens(k)).map((each) => [`id:${each.id}`, `${each.model}, ${each.width} × ${each.height}`]));
  group("Other", [["fill", "pinhole that fills the window"]]);
  group("Examples of models", Object.keys(scene.models).map((name) => [`model:${name}`, name]));
}

// --- the page ------------------------------------------------------------------------------------
function layout() {
  if (!lens) return;
  const [width, height] = size();
  Object.assign($("picture").style, { width: width + "px", height: height + "px" });
}
function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1e4);
}
const fileName = () => scene.name.replace(/[^\w.-]+/g, "-");
const stamp = () => new Date().toISOString().slice(0, 19).replace(/[:T]/g, "-");
async function screenshot() {
  const values = { ...request(false), quality: null }, name = `${fileName()}-${stamp()}`;
  save(await server.file("frame", values), name + ".png");
  save(await server.file("camera", { poses: [values.pose], lens: values.lens, turns: values.turns, width: values.width, height: values.height }), name + ".json");
  toast(`${name}.png and its camera, ${name}.json`);
}
function keysChanged() {
  const count = state.keys.length;
  $("keys-text").textContent = count ? `${count} keyframe${count > 1 ? "s" : ""}` : "No keyframes yet.";
}
async function fillFindings() {
  $("findings").hidden = false;
  const rows = await ask("findings");
  $("findings-text").textContent = rows.some((row) => row.severity === "error") ? "Training cannot start." : "Training can start.";
  $("findings-list").replaceChildren(...rows.map((row) => {
    const item = document.createElement("li");
    item.className = row.severity;
    item.textContent = `${row.where.replace(/^.*[/]/, "")}: ${row.what}${row.advice ? "; " + row.advice : ""}`;
    return item;
  }));
}

// --- a live training ------------------------------------------------------------------------------
function curve(id, rows, key) {
  const points = rows.filter((row) => row[key] != null), values = points.map((row) => row[key]);
  if (!points.length) return;
  const low = Math.min(...values), high = Math.max(...values), last = rows.at(-1).step || 1;
  $(id).setAttribute("points", points.map((row) => `${(300 * row.step / last).toFixed(1)},${(84 - 78 * (row[key] - low) / (high - low || 1)).toFixed(1)}`).join(" "));
}
async function followTraining() {
  $("training").hidden = false;
  for (let before = ""; ;) {
    const now = await ask("training");
    $("train-bar").value = now.steps ? now.step / now.steps : 0;
    const best = now.history.filter((row) => row.psnr != null).at(-1);
    $("train-text").textContent = now.state === "preparing" ? "Preparing …" : `${now.state}: step ${now.step.toLocaleString()} of ${now.steps.toLocaleString()}, ${now.num_gaussians.toLocaleString()} Gaussians`;
    $("curve-best").textContent = best ? `held-out PSNR, now ${best.psnr.toFixed(2)} dB` : "held-out PSNR";
    $("train-pause").textContent = now.state === "paused" ? "Resume" : "Pause";
    $("train-pause").disabled = $("train-stop").disabled = now.state === "finished";
    curve("curve-loss", now.history, "loss");
    curve("curve-psnr", now.history, "psnr");
    scene.num_gaussians = now.num_gaussians;
    facts();
    const mark = `${now.step} ${now.state}`;
    if (mark !== before && performance.now() - lastMove > 400) redraw(false);
    before = mark;
    if (now.state === "finished") return;
    await new Promise((done) => setTimeout(done, 1000));
  }
}
function facts() {
  const parts = [];
  if (scene.kind !== "data" && scene.num_gaussians) parts.push(`${scene.num_gaussians.toLocaleString()} Gaussians`);
  if (scene.views.length) parts.push(`${scene.views.length} photograph${scene.views.length > 1 ? "s" : ""}`);
  if (scene.kind === "data") parts.push(`${scene.num_points.toLocaleString()} points`);
  if (scene.figures.psnr) parts.push(`${scene.figures.psnr.toFixed(2)} dB held out`);
  $("facts").textContent = parts.join(" · ");
}

function connect() {
  const canvas = $("canvas");
  canvas.addEventListener("pointerdown", onPointerDown);
  canvas.addEventListener("pointermove", onPointerMove);
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, onPointerUp);
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", guarded(setPivot));
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); flight++; dolly(-Math.sign(event.deltaY) * Math.min(0.25, Math.abs(event.deltaY) / 500)); }, { passive: false });
  addEventListener("keydown", onKeyDown);
  addEventListener("keyup", (event) => held.delete(event.code));
  addEventListener("blur", () => held.clear());
  new ResizeObserver(() => { layout(); if (reshape) makeLens({ ...reshape, fit: windowShape() }); else redraw(); }).observe($("stage"));
  const drag = (event) => {
    const box = $("picture").getBoundingClientRect();
    $("fade").value = Math.max(0, Math.min(100, 100 * (event.clientX - box.left) / box.width));
    compare();
  };
  $("wipe").addEventListener("pointerdown", (event) => { $("wipe").setPointerCapture(event.pointerId); $("wipe").onpointermove = drag; });
  $("wipe").addEventListener("pointerup", () => ($("wipe").onpointermove = null));
  const on = (id, name, action) => $(id).addEventListener(name, guarded(action));
  on("fade", "input", compare);
  on("rolling", "change", () => redraw());
  on("mask", "change", () => state.view !== null && choosePhotograph(state.view));
  on("previous", "click", () => goTo((state.view ?? 0) - 1));
  on("next", "click", () => goTo((state.view ?? -1) + 1));
  on("shot", "click", screenshot);
  on("help-open", "click", () => $("help").showModal());
  on("panel-toggle", "click", () => $("panel-toggle").setAttribute("aria-expanded", String(!document.body.classList.toggle("narrow"))));
  on("lossless", "change", () => lossless($("lossless").checked));
  on("home", "click", () => { if (scene.views.length) goTo(0); else fly(eyeOf(scene.pose), () => redraw()); });
  on("level", "click", levelled);
  const turnUp = (up) => { state.up = up; levelled(); };
  on("up", "change", () => turnUp(JSON.parse($("up").value)));
  on("up-here", "click", () => turnUp(column(state.eye.R, 1).map((x) => -x)));
  on("speed", "input", () => ($("speed-text").textContent = format(2 ** $("speed").value) + " ×"));
  on("measure", "click", () => {
    state.measuring = !state.measuring;
    $("measure").setAttribute("aria-pressed", String(state.measuring));
    $("canvas").classList.toggle("picking", state.measuring);
  });
  on("measure-clear", "click", () => { state.marks = []; $("measured").hidden = true; redraw(false); });
  on("lens", "change", () => {
    const [kind, name] = $("lens").value.split(":");
    if (kind === "fill") {
      reshape = { model: "pinhole", field_of_view: PLAIN_FIELD };
      return makeLens({ ...reshape, fit: windowShape() });
    }
    if (kind === "id") { leavePhotograph(); return useLens(ownLens(Number(name))); }
    reshape = { model: name };
    makeLens({ model: name, fit: windowShape() });
  });
  on("fov", "input", () => {
    $("fov-text").textContent = $("fov").value + "°";
    if (reshape) reshape.field_of_view = Number($("fov").value);
    makeLens({ id: lens.id, turns: lens.turns, field_of_view: Number($("fov").value) });
  });
  on("lens-form", "submit", (event) => { event.preventDefault(); return makeLens({ path: $("lens-path").value }); });
  on("lens-file", "change", async () => {
    const file = $("lens-file").files[0];
    if (!file) return;
    const bytes = new Uint8Array(await file.arrayBuffer());
    await makeLens({ name: file.name, base64: btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join("")) });
  });
  on("key-add", "click", () => { state.keys.push(state.exact ?? poseOf(state.eye)); keysChanged(); toast(`keyframe ${state.keys.length}`, 1.5); });
  on("key-remove", "click", () => { state.keys.pop(); keysChanged(); });
  on("key-save", "click", async () => {
    const { width, height, turns } = lens;
    save(await server.file("camera", { poses: state.keys, lens: lens.id, turns, width, height }), `${fileName()}-path.json`);
  });
  on("train-pause", "click", () => ask("training", { action: $("train-pause").textContent === "Pause" ? "pause" : "resume" }));
  on("train-stop", "click", () => ask("training", { action: "stop" }));
}

async function begin() {
  scene = await ask("scene");
  document.title = scene.alone ? scene.name : `${scene.name} · gsut view`;
  $("name").textContent = scene.name;
  $("credit").textContent = scene.credit ?? "";
  $("credit").hidden = !scene.credit;
  facts();
  state.up = scene.up;
  state.pivot = scene.center;
  state.eye = eyeOf(scene.pose);
  const plain = scene.kind === "data" ? ["color", "distance", "centers"] : scene.modes;
  choices("modes", Object.fromEntries(plain.map((name) => [name, MODE_NAMES[name]])), "color", (name) => { state.mode = name; redraw(); });
  if (scene.kind === "data" && scene.views.length) state.compare = "photo";
  choices("compare", COMPARE_NAMES, state.compare, (name) => { state.compare = name; compare(); });
  choices("navigation", { walk: "Walk", orbit: "Orbit" }, "walk", (name) => (state.navigation = name));
  for (const [name, text] of Object.entries(LAYER_NAMES)) {
    if ((name === "cameras" && !scene.views.length) || (name === "points" && !scene.num_points)) continue;
    const label = document.createElement("label"), input = document.createElement("input");
    label.className = "check";
    Object.assign(input, { type: "checkbox", value: name });
    input.addEventListener("change", () => { state.layers[input.checked ? "add" : "delete"](name); redraw(); });
    label.append(input, text);
    $("layers").append(label);
  }
  $("mask-row").hidden = !scene.views.length || scene.alone;
  $("layers-section").hidden = $("lens-form").hidden = scene.alone ?? false;
  fillStrip();
  fillLenses();
  $("up").append(new Option(scene.views.length ? "the cameras’" : "the file’s", JSON.stringify(scene.up)));
  ["+x", "−x", "+y", "−y", "+z", "−z"].forEach((name, k) => {
    const axis = [0, 0, 0];
    axis[k >> 1] = k % 2 ? -1 : 1;
    $("up").append(new Option(name, JSON.stringify(axis)));
  });
  connect();
  connectSelecting();
  if (innerWidth <= 760) $("panel-toggle").click();
  compare();
  const asked = /view=(\d+)/.exec(location.hash)?.[1];
  if (scene.presets?.length && !asked) visit(scene.presets[0]);
  else if (scene.views.length) goTo(Math.min(scene.views.length - 1, Number(asked ?? 0)));
  else { reshape = { id: 0 }; await makeLens({ id: 0, fit: windowShape() }); }
  if (scene.kind === "data") await fillFindings();
  if (scene.live) await followTraining();
}
begin().catch((error) => { // nothing here works then: the reason stays
  document.body.classList.add("narrow");
  toast(error.message, 1e6);
});
