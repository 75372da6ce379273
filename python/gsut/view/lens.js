// The lens page: draws a lens file's image plane, its domain and its grid, and turns pixels into rays and back.
"use strict";
const $ = part;
const GRID_NAMES = { angles: "Angles", lines: "Straight lines", both: "Both" };
// Degrees between two rings of equal angle from the axis, the first that gives at most this many.
const RING_STEPS = [1, 2, 5, 10, 15, 30], MOST_RINGS = 12;
// Degrees between two spokes of equal azimuth.
const SPOKE_STEP = 15;
// Degrees between two points of a drawn line.
const LINE_STEP = 0.5;
// Pixels, of the canvas, beyond which two neighbours of a line are not joined: the lens' edge lies between.
const JUMP = 40;
// Columns of the image that is asked which pixels have a ray.
const DOMAIN_SIDE = 320;
// Tangents of the straight lines, from the axis outwards on both sides, and how far each one reaches.
const LINES = [0, 0.2, 0.4, 0.6, 0.8, 1, 1.5, 2, 3, 5], REACH = 12;
// Points of the curve of distance by angle.
const CURVE_POINTS = 120;

const DEGREE = Math.PI / 180;
let core, models, found = [], lens, camera = null, facts, chosen = "both", mark = null;

const format = (x) => (Math.abs(x) >= 1e5 || (x && Math.abs(x) < 1e-3) ? x.toExponential(4) : +x.toPrecision(7) + "");
function toast(text) { $("toast").textContent = text; $("toast").hidden = !text; }
function complain(error) { $("error").textContent = error?.message ?? ""; $("error").hidden = !error; }
const guarded = (action) => async (...event) => { try { await action(...event); complain(null); } catch (error) { complain(error); } };

// --- what the lens does ----------------------------------------------------------------------------
const direction = (angle, azimuth) => [Math.sin(angle) * Math.cos(azimuth), Math.sin(angle) * Math.sin(azimuth), Math.cos(angle)];
const project = (points) => core.project(camera, points.flat());
const unproject = (pixels) => core.unproject(camera, pixels.flat());
const angleOf = ([x, y, z]) => Math.atan2(Math.hypot(x, y), z);
const isInside = (u, v) => u >= 0 && v >= 0 && u <= lens.width && v <= lens.height;

function arcOf(pixels) { // degrees along a line of pixels, by the angles between neighbours with a ray
  const { rays, valid } = unproject(pixels), seen = [];
  valid.forEach((ok, k) => ok && seen.push(rays.subarray(3 * k, 3 * k + 3)));
  return seen.slice(1).reduce((sum, b, k) => sum + 2 * Math.asin(Math.min(1, Math.hypot(b[0] - seen[k][0], b[1] - seen[k][1], b[2] - seen[k][2]) / 2)), 0) / DEGREE;
}
function measureLens() {
  const { width, height } = lens, steps = Array.from({ length: 201 }, (_, k) => k / 200), described = core.describeCamera(camera);
  const small = core.resizeCamera(camera, DOMAIN_SIDE, Math.max(1, Math.round(DOMAIN_SIDE * height / width)));
  const size = [DOMAIN_SIDE, Math.max(1, Math.round(DOMAIN_SIDE * height / width))];
  let valid;
  try { valid = core.validPixels(small, size[0] * size[1]); } finally { core.releaseCamera(small); }
  const axis = project([[0, 0, 1]]);
  return {
    described, size, valid, share: valid.reduce((a, b) => a + b, 0) / valid.length, axis: axis.valid[0] ? [...axis.pixels] : null,
    across: arcOf(steps.map((s) => [s * width, height / 2])), down: arcOf(steps.map((s) => [width / 2, s * height])),
    diagonal: arcOf(steps.map((s) => [s * width, s * height])), limit: described.max_angle / DEGREE,
  };
}

// --- drawing ---------------------------------------------------------------------------------------
function fit() {
  const area = $("stage").getBoundingClientRect(), shape = lens.width / lens.height, edge = 24;
  const width = Math.max(16, Math.min(area.width - edge, (area.height - edge) * shape)), height = width / shape;
  Object.assign($("picture").style, { width: `${width}px`, height: `${height}px` });
  const canvas = $("canvas"), ratio = Math.min(2, devicePixelRatio);
  [canvas.width, canvas.height] = [width, height].map((side) => Math.max(1, Math.round(side * ratio)));
  return canvas.width / lens.width;
}
function drawLine(brush, scale, points) {
  const { pixels, valid } = project(points);
  brush.beginPath();
  for (let k = 0, last = null; k < points.length; k++) {
    const at = valid[k] ? [pixels[2 * k] * scale, pixels[2 * k + 1] * scale] : null;
    if (at) brush[last && Math.hypot(at[0] - last[0], at[1] - last[1]) < JUMP * devicePixelRatio ? "lineTo" : "moveTo"](...at);
    last = at;
  }
  brush.stroke();
}
function drawDomain(brush, canvas) {
  const [width, height] = facts.size, data = new ImageData(width, height), dark = matchMedia("(prefers-color-scheme: dark)").matches;
  facts.valid.forEach((ok, i) => data.data.set(ok ? (dark ? [24, 36, 48, 255] : [246, 249, 252, 255]) : [(i + (i / width | 0)) % 8 < 2 ? 150 : 112, 60, 56, 255], 4 * i));
  const small = Object.assign(document.createElement("canvas"), { width, height });
  small.getContext("2d").putImageData(data, 0, 0);
  brush.imageSmoothingEnabled = false;
  brush.drawImage(small, 0, 0, canvas.width, canvas.height);
}
function drawAngles(brush, scale, dark) {
  const limit = Math.min(180, facts.limit), step = RING_STEPS.find((each) => limit / each <= MOST_RINGS) ?? 30, ring = 2 * LINE_STEP;
  const azimuths = Array.from({ length: 360 / ring + 1 }, (_, k) => k * ring * DEGREE);
  brush.strokeStyle = dark ? "#5fb2ff" : "#1668b8";
  brush.fillStyle = brush.strokeStyle;
  brush.font = `${11 * Math.min(2, devicePixelRatio)}px system-ui, sans-serif`;
  for (let angle = step; angle < limit + 1e-9; angle += step) {
    brush.lineWidth = (angle % (3 * step) ? 0.7 : 1.5) * Math.min(2, devicePixelRatio);
    drawLine(brush, scale, azimuths.map((azimuth) => direction(angle * DEGREE, azimuth)));
    const { pixels, valid } = project([direction(angle * DEGREE, 0)]);
    if (valid[0] && isInside(...pixels)) brush.fillText(`${angle}°`, pixels[0] * scale + 2, pixels[1] * scale - 3);
  }
  brush.lineWidth = 0.7 * Math.min(2, devicePixelRatio);
  const steps = Array.from({ length: Math.floor(limit / LINE_STEP) + 1 }, (_, k) => k * LINE_STEP * DEGREE);
  for (let azimuth = 0; azimuth < 360; azimuth += SPOKE_STEP) drawLine(brush, scale, steps.map((angle) => direction(angle, azimuth * DEGREE)));
  return step;
}
function drawStraight(brush, scale) { // lines of a wall in front of the camera, at distance 1
  const along = Array.from({ length: 241 }, (_, k) => Math.sinh((k - 120) / 120 * Math.asinh(REACH)));
  brush.strokeStyle = "#d9822b";
  brush.lineWidth = 1.1 * Math.min(2, devicePixelRatio);
  for (const tangent of new Set(LINES.flatMap((value) => [value, -value]))) {
    drawLine(brush, scale, along.map((value) => [tangent, value, 1]));
    drawLine(brush, scale, along.map((value) => [value, tangent, 1]));
  }
}
function draw() {
  if (!lens) return;
  const canvas = $("canvas"), scale = fit(), brush = canvas.getContext("2d"), dark = matchMedia("(prefers-color-scheme: dark)").matches;
  drawDomain(brush, canvas);
  const step = chosen === "lines" ? 0 : drawAngles(brush, scale, dark);
  if (chosen !== "angles") drawStraight(brush, scale);
  if (mark) {
    brush.strokeStyle = "#1f8a4c";
    brush.lineWidth = 2 * devicePixelRatio;
    brush.beginPath();
    brush.arc(mark[0] * scale, mark[1] * scale, 6 * devicePixelRatio, 0, 7);
    brush.stroke();
  }
  const words = [step && `Blue: every ${step}° from the axis, every ${SPOKE_STEP}° around it.`, chosen !== "angles" && "Orange: straight lines of a wall in front of the camera.", facts.share < 1 && "Red: pixels without a ray."];
  $("grid-text").textContent = words.filter(Boolean).join(" ");
  document.body.dataset.drawn = Number(document.body.dataset.drawn ?? 0) + 1;
}
function drawCurve() { // by angle, to the right of the axis' image where the image is larger
  const limit = Math.min(Math.PI, facts.described.max_angle), angles = Array.from({ length: CURVE_POINTS + 1 }, (_, k) => k * limit / CURVE_POINTS);
  const { pixels, valid } = project(angles.map((angle) => direction(angle, 0))), first = project([direction(1e-4, 0)]);
  const center = facts.axis ?? [lens.width / 2, lens.height / 2], far = (k) => Math.hypot(pixels[2 * k] - center[0], pixels[2 * k + 1] - center[1]);
  const focal = Math.hypot(first.pixels[0] - center[0], first.pixels[1] - center[1]) / 1e-4;
  const most = Math.max(1, ...angles.map((_, k) => (valid[k] ? far(k) : 0))), at = (angle, r) => `${(300 * angle / limit).toFixed(1)},${(146 - 140 * r / most).toFixed(1)}`;
  const set = (id, keep, value) => $(id).setAttribute("points", angles.map((angle, k) => (keep(angle, k) ? at(angle, value(angle, k)) : "")).filter(Boolean).join(" "));
  set("curve-psnr", (_, k) => valid[k], (_, k) => far(k));
  set("curve-tangent", (angle) => angle < 1.5 && focal * Math.tan(angle) <= most * 1.05, (angle) => focal * Math.tan(angle));
  set("curve-angle", (angle) => focal * angle <= most * 1.05, (angle) => focal * angle);
}

// --- pixels and points -----------------------------------------------------------------------------
function showRay() {
  const pixel = [Number($("u").value), Number($("v").value)], { origins, rays, valid } = unproject([pixel]);
  mark = pixel;
  if (!valid[0]) $("ray-text").textContent = "This pixel has no ray.";
  else {
    const ray = [...rays], again = core.project(camera, ray.map((value, k) => origins[k] + value * 1e6)), off = again.valid[0] ? Math.hypot(again.pixels[0] - pixel[0], again.pixels[1] - pixel[1]) : null;
    const start = lens.central ? [] : [`starts at ${[...origins].map(format).join(", ")}`];
    $("ray-text").textContent = [`ray  ${ray.map(format).join(", ")}`, `${format(angleOf(ray) / DEGREE)}° from the axis, ${format(Math.atan2(ray[1], ray[0]) / DEGREE)}° around it`, ...start,
      off === null ? "does not project back into the image" : `projects back within ${off < 1e-12 ? "1e-12" : off.toExponential(1)} px`].join("\n");
  }
  draw();
}
function showPixel() {
  const point = ["x", "y", "z"].map((id) => Number($(id).value));
  if (!Math.hypot(...point)) return ($("pixel-text").textContent = "The camera's centre has no pixel.");
  const { pixels, valid } = project([point]);
  $("pixel-text").textContent = !valid[0] ? `No pixel: ${format(angleOf(point) / DEGREE)}° from the axis lies outside the lens' domain.` : `pixel  ${format(pixels[0])}, ${format(pixels[1])}${isInside(...pixels) ? "" : "\noutside the image"}`;
  if (valid[0]) { mark = [...pixels]; draw(); }
}

// --- the lens --------------------------------------------------------------------------------------
function useLens(next) {
  const made = core.makeCamera(next), before = camera;
  camera = made;
  lens = { ...next, central: core.describeCamera(made).central };
  if (before !== null) core.releaseCamera(before);
  facts = measureLens();
  mark = null;
  $("name").textContent = next.name;
  $("facts").textContent = `${lens.model}, ${lens.width} × ${lens.height}`;
  const angle = (value) => `${format(+value.toFixed(1))}°`, where = facts.axis ? `The axis is at pixel ${facts.axis.map((value) => format(+value.toFixed(2))).join(", ")}.` : "The axis has no pixel.";
  $("domain-text").textContent = `${angle(facts.across)} across, ${angle(facts.down)} down, ${angle(facts.diagonal)} along the diagonal. ${facts.share === 1 ? "Every pixel has a ray" : `${(100 * facts.share).toFixed(1)} % of the pixels have a ray`}; the lens sees to ${angle(Math.min(180, facts.limit))} off its axis. ${where}${lens.central ? "" : " Its rays do not meet in one point."}`;
  const names = models[lens.model].names.split(" ");
  $("params").textContent = lens.params.slice(0, 40).map((value, k) => `${names[k] && names[k] !== "..." ? names[k] : `coefficient ${k + 1}`} = ${value}`).join("\n") + (lens.params.length > 40 ? `\nand ${lens.params.length - 40} more` : "");
  [$("u").value, $("v").value] = [lens.width / 2, lens.height / 2];
  drawCurve();
  showRay();
  showPixel();
}
async function readFile(file) {
  if (!file) return;
  if (file.size > 2e7) throw new Error(`${file.name}: ${(file.size / 1e6).toFixed(0)} MB is no lens file`);
  const lenses = LensFile.read(core, file.name, await file.text());
  useLens(lenses[0]);
  offer(lenses);
}
function offer(lenses) {
  found = lenses;
  $("which").replaceChildren(...found.map((each, k) => new Option(each.name, k)));
  $("which-row").hidden = found.length < 2;
}
function save() {
  const { model, params, width, height, valid_field_angle } = lens, link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([JSON.stringify({ model, params, width, height, valid_field_angle }, null, 1) + "\n"], { type: "application/json" }));
  link.download = `${lens.name.replace(/\.[^.]*$/, "").replace(/[^\w-]+/g, "-")}.lens.json`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1e4);
}
function connect() {
  for (const [value, text] of Object.entries(GRID_NAMES)) {
    const label = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "radio", name: "grids", value, checked: value === chosen });
    input.addEventListener("change", () => { chosen = value; draw(); });
    label.append(input, text);
    $("grids").append(label);
  }
  $("canvas").addEventListener("click", (event) => {
    const box = $("canvas").getBoundingClientRect();
    [$("u").value, $("v").value] = [(event.clientX - box.left) / box.width * lens.width, (event.clientY - box.top) / box.height * lens.height].map((value) => +value.toFixed(2));
    showRay();
  });
  for (const id of ["u", "v"]) $(id).addEventListener("input", guarded(showRay));
  for (const id of ["x", "y", "z"]) $(id).addEventListener("input", guarded(showPixel));
  $("file").addEventListener("change", guarded(() => readFile($("file").files[0])));
  $("which").addEventListener("change", guarded(() => useLens(found[Number($("which").value)])));
  $("example").append(new Option("choose a model", ""), ...Object.keys(models).map((name) => new Option(name, name)));
  $("example").addEventListener("change", guarded(() => $("example").value && useExample($("example").value)));
  $("save").addEventListener("click", save);
  addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("dropping"); });
  addEventListener("dragleave", () => document.body.classList.remove("dropping"));
  addEventListener("drop", guarded((event) => { event.preventDefault(); document.body.classList.remove("dropping"); return readFile(event.dataTransfer.files[0]); }));
  new ResizeObserver(draw).observe($("stage"));
}
function useExample(model) {
  const { params, width, height } = models[model];
  useLens({ name: `Example of ${model}`, model, params, width, height, valid_field_angle: null });
  offer([]);
}
async function begin() {
  core = await Core.load(await unpack("core", "gzip"));
  models = core.models();
  const content = JSON.parse($("content").textContent);
  connect();
  if (content.lens) useLens(content.lens);
  else useExample(content.example);
}
begin().catch((error) => toast(error.message));
