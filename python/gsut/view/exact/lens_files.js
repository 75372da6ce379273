// Reads lens files in a page: gsut's JSON, mrcal, transforms.json, OpenCV's YAML and JSON, COLMAP's
// cameras.txt. What gsut.load_camera reads of these formats, with the same meaning; other formats and
// whatever a page cannot know are refused.
"use strict";
const KNOWN_FILES = "a page reads gsut's .json, mrcal's .cameramodel, transforms.json, OpenCV's .yaml and COLMAP's cameras.txt; 'gsut camera convert' reads the others";
// Pixels from OpenCV's convention, whose first pixel has its centre at 0, to gsut's.
const PIXEL_SHIFT = 0.5;
// OpenCV's number of coefficients -> the lens.
const RADIAL_LENSES = { 0: "pinhole", 4: "opencv4", 5: "opencv5", 8: "opencv8", 12: "opencv12", 14: "opencv14" };
const FISHEYE_NAMES = ["equidistant", "fisheye", "equi", "kannala_brandt", "opencv_fisheye"];
const RADIAL_NAMES = ["plumb_bob", "radtan", "rational_polynomial", "brown_conrady", "opencv", "pinhole"];

// COLMAP's model -> number of parameters, gsut's lens, and its parameters: the focal length stands twice
// where COLMAP has one, and zeros follow.
const twice = (p) => [p[0], ...p], same = (p) => p;
const COLMAP_MODELS = {
  SIMPLE_PINHOLE: [3, "pinhole", twice], PINHOLE: [4, "pinhole", same], SIMPLE_RADIAL: [4, "opencv4", (p) => [...twice(p), 0, 0, 0]],
  RADIAL: [5, "opencv4", (p) => [...twice(p), 0, 0]], OPENCV: [8, "opencv4", same], OPENCV_FISHEYE: [8, "kannala_brandt", same],
  FULL_OPENCV: [12, "opencv8", same], FOV: [5, "fov", same], SIMPLE_RADIAL_FISHEYE: [4, "kannala_brandt", twice],
  RADIAL_FISHEYE: [5, "kannala_brandt", twice], THIN_PRISM_FISHEYE: [12, "thin_prism_fisheye", same],
  RAD_TAN_THIN_PRISM_FISHEYE: [16, "fisheye624", same], SIMPLE_DIVISION: [4, "division", twice], DIVISION: [5, "division", same],
  SIMPLE_FISHEYE: [3, "kannala_brandt", twice], FISHEYE: [4, "kannala_brandt", same], EUCM: [6, "extended_unified", same],
};

class LensFile {
  // Returns the lenses of a file: [{ name, model, params, width, height, valid_field_angle }].
  static read(core, name, text) {
    const file = new LensFile(name, text);
    if (text.includes("\0")) file.fail(`is no text; ${KNOWN_FILES}`);
    const found = file.list(core);
    for (const lens of found) file.check(core, lens);
    return found;
  }
  constructor(name, text) { Object.assign(this, { name, text }); }
  fail(words) { throw new Error(`${this.name}: ${words}`); }
  list(core) {
    if (/\.cameramodel$/i.test(this.name)) return [this.readMrcal(core)];
    if (/\.ya?ml$/i.test(this.name)) return [this.readOpenCV(this.parseYaml())];
    if (/\.txt$/i.test(this.name)) return this.readColmap();
    let values;
    try { values = JSON.parse(this.text); } catch (error) { this.fail(`is no JSON (${error.message}); ${KNOWN_FILES}`); }
    if (values === null || typeof values !== "object" || Array.isArray(values)) this.fail(`holds no lens; ${KNOWN_FILES}`);
    if ("model" in values && "params" in values) return [this.readOwn(values)];
    if (["fl_x", "camera_angle_x", "frames", "camera_model", "lens_file"].some((key) => key in values)) return this.readTransforms(values);
    return [this.readOpenCV(values)];
  }
  check(core, lens) { // an impossible lens is refused in the core's words
    for (const key of ["width", "height"]) if (!Number.isInteger(lens[key]) || lens[key] < 1 || lens[key] > 65536) this.fail(`${key} is ${lens[key]}, not a number of pixels`);
    if (!lens.params.every(Number.isFinite)) this.fail(`the parameters of ${lens.model} are not all numbers: ${lens.params.join(", ")}`);
    try { core.releaseCamera(core.makeCamera(lens)); } catch (error) { this.fail(error.message); }
  }
  number(values, key, otherwise) {
    const value = values[key] ?? otherwise;
    if (value === undefined || value === "" || typeof value === "boolean" || !Number.isFinite(Number(value))) this.fail(`${key} is ${value === undefined ? "missing" : JSON.stringify(value) + ", not a number"}`);
    return Number(value);
  }
  numbers(values, key) {
    const value = values[key], list = Array.isArray(value) ? value.flat(Infinity) : value?.data;
    if (!Array.isArray(list) || !list.every((each) => typeof each === "number" && Number.isFinite(each))) this.fail(`${key} is not a list of numbers`);
    return list;
  }
  first(values, ...keys) { return keys.find((key) => values[key] !== undefined && values[key] !== null); }

  // --- formats ---
  readOwn(values) {
    if (!Array.isArray(values.params) || typeof values.model !== "string") this.fail('"model" must be a name and "params" a list of numbers');
    const angle = values.valid_field_angle ?? null;
    return { name: this.name, model: values.model, params: values.params, width: values.width, height: values.height, valid_field_angle: angle === null ? null : this.number(values, "valid_field_angle") };
  }
  readMrcal(core) {
    const camera = core.readCamera(this.text, this.name);
    try { return { name: this.name, valid_field_angle: null, ...(({ model, params, width, height }) => ({ model, params, width, height }))(core.describeCamera(camera)) }; } finally { core.releaseCamera(camera); }
  }
  readColmap() {
    const found = [];
    this.text.split(/\r?\n/).forEach((line, at) => {
      const [id, model, width, height, ...params] = line.split("#")[0].trim().split(/\s+/);
      if (!id) return;
      if (model === "EQUIRECTANGULAR" && params.join() === `${width},${height}`) return found.push({ name: `camera ${id}`, model: "equirectangular", params: [], width: Number(width), height: Number(height), valid_field_angle: null });
      const known = COLMAP_MODELS[model];
      if (!known) this.fail(`line ${at + 1}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS[] with a model of ${Object.keys(COLMAP_MODELS).join(", ")}, found ${JSON.stringify(line.trim().slice(0, 80))}`);
      if (params.length !== known[0]) this.fail(`line ${at + 1}: ${model} has ${known[0]} parameters, found ${params.length}`);
      found.push({ name: `camera ${id}`, model: known[1], params: known[2](params.map(Number)), width: Number(width), height: Number(height), valid_field_angle: null });
    });
    if (!found.length) this.fail("holds no camera");
    return found;
  }
  readTransforms(values) {
    const found = new Map(), frames = Array.isArray(values.frames) ? values.frames : [];
    const keys = /^(w|h|camera_model|is_fisheye|fl_[xy]|c[xy]|camera_angle_[xy]|max_theta_rad|distortion_params|k[1-6]|p[12])$/;
    const own = frames.filter((frame) => Object.keys(frame ?? {}).some((key) => keys.test(key) || key === "lens_file"));
    if (values.lens_file || own.some((frame) => frame.lens_file)) this.fail(`names its lens's file (${values.lens_file ?? own.find((frame) => frame.lens_file).lens_file}); drop that file instead`);
    for (const frame of own.length ? own : [{}]) {
      const { name, ...lens } = this.readFrame({ ...values, ...frame });
      found.set(JSON.stringify(lens), { name: found.size ? `camera ${found.size + 1}` : name, ...lens });
    }
    return [...found.values()];
  }
  readFrame(values) {
    const width = this.number(values, "w"), height = this.number(values, "h"), coefficients = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"];
    const k = Object.fromEntries(coefficients.map((key) => [key, this.number(values, key, 0)])), distorted = coefficients.some((key) => k[key]);
    const model = values.camera_model ?? (values.is_fisheye ? "OPENCV_FISHEYE" : distorted ? "OPENCV" : "PINHOLE");
    const lens = { name: this.name, width, height, valid_field_angle: values.max_theta_rad == null ? null : this.number(values, "max_theta_rad") };
    if (model === "EQUIRECTANGULAR") return { ...lens, model: "equirectangular", params: [] };
    const focal = (key, angle, side) => (values[key] != null ? this.number(values, key) : side / 2 / Math.tan(this.number(values, angle) / 2));
    const fx = focal("fl_x", "camera_angle_x", width), fy = values.fl_y != null || values.camera_angle_y != null ? focal("fl_y", "camera_angle_y", height) : fx;
    const plane = [fx, fy, this.number(values, "cx", width / 2), this.number(values, "cy", height / 2)], pick = (...names) => [...plane, ...names.map((key) => k[key])];
    if (/^(PINHOLE|SIMPLE_PINHOLE|PERSPECTIVE)$/.test(model)) return distorted ? this.fail(`camera_model is ${model}, yet the file gives distortion; use OPENCV`) : { ...lens, model: "pinhole", params: plane };
    if (model === "FISHEYE624") return { ...lens, model: "fisheye624", params: [...plane, ...this.numbers(values, "distortion_params")] };
    if (model === "FULL_OPENCV") return { ...lens, model: "opencv8", params: pick("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6") };
    if (/^(OPENCV|SIMPLE_RADIAL|RADIAL)$/.test(model)) {
      if (k.k4 || k.k5 || k.k6) this.fail("k4 means r^8 to nerfstudio and the denominator to OpenCV; set k4 to k6 to 0, or camera_model to FULL_OPENCV for OpenCV's meaning");
      return { ...lens, model: k.k3 ? "opencv5" : "opencv4", params: pick("k1", "k2", "p1", "p2", ...(k.k3 ? ["k3"] : [])) };
    }
    if (!/^(OPENCV_FISHEYE|SIMPLE_RADIAL_FISHEYE|RADIAL_FISHEYE)$/.test(model)) this.fail(`camera_model ${JSON.stringify(model)} is not known to this page`);
    if (k.k5 || k.k6 || k.p1 || k.p2) this.fail(`${model} has k1 to k4 only: name the model OPENCV for p1, p2`);
    return { ...lens, model: "kannala_brandt", params: pick("k1", "k2", "k3", "k4") };
  }
  readOpenCV(values) {
    const matrixKey = this.first(values, "camera_matrix", "K", "cameraMatrix");
    if (!matrixKey) this.fail(`holds no camera_matrix; ${KNOWN_FILES}`);
    const m = this.numbers(values, matrixKey), key = this.first(values, "distortion_coefficients", "D", "distCoeffs", "dist_coeffs");
    if (m.length !== 9 || m[1] || m[3] || m[6] || m[7] || m[8] !== 1) this.fail(`${matrixKey}: expected fx 0 cx, 0 fy cy, 0 0 1, found ${m.join(" ")}`);
    if (this.first(values, "xi")) this.fail("a lens of omnidir: convert it by 'gsut camera convert FILE mei -o lens.json'");
    const widthKey = this.first(values, "image_width", "width", "imageWidth") ?? "image_width", heightKey = this.first(values, "image_height", "height", "imageHeight") ?? "image_height";
    const d = key ? this.numbers(values, key) : [], flag = this.first(values, "fisheye", "fisheye_model"), named = String(values[this.first(values, "distortion_model", "camera_model", "model")] ?? "").toLowerCase();
    const fisheye = flag ? !/^(0|false|no|none)$/i.test(String(values[flag])) : FISHEYE_NAMES.includes(named) ? true : RADIAL_NAMES.includes(named) ? false : null;
    if (fisheye === null && d.length === 4) this.fail("4 coefficients are k1 k2 p1 p2, or a fisheye's k1 to k4, and nothing says which: add 'distortion_model: plumb_bob' or 'distortion_model: equidistant'");
    const model = fisheye ? (d.length === 4 ? "kannala_brandt" : null) : RADIAL_LENSES[d.length];
    if (!model) this.fail(`${d.length} distortion coefficients fit no lens${fisheye ? "; a fisheye has 4" : ""}`);
    const angle = values.valid_field_angle ?? null;
    return { name: this.name, model, params: [m[0], m[4], m[2] + PIXEL_SHIFT, m[5] + PIXEL_SHIFT, ...d], width: this.number(values, widthKey), height: this.number(values, heightKey), valid_field_angle: angle === null ? null : this.number(values, "valid_field_angle") };
  }
  // The YAML that OpenCV and ROS write: keys in one or two levels, numbers, words, lists in brackets or by
  // dashes. What it does not understand it refuses.
  parseYaml() {
    const values = {}, lines = this.text.replace(/\[[^\]]*\]/g, (list) => list.replace(/\s+/g, " ")).split(/\r?\n/);
    let inner = null; // the matrix, or list, that indented lines belong to
    lines.forEach((raw, at) => {
      const line = raw.replace(/(^|\s)#.*$/, "");
      if (!line.trim() || /^(%|---|\.\.\.)/.test(line)) return;
      const dash = /^\s*-\s*(.*)$/.exec(line), found = /^(\s*)([\w.]+)\s*:\s*(.*)$/.exec(line);
      if (dash && inner) {
        if (!Array.isArray(values[inner])) values[inner] = [];
        return values[inner].push(this.parseScalar(dash[1].trim(), at));
      }
      if (!found) this.fail(`line ${at + 1}: a page does not understand ${JSON.stringify(line.trim().slice(0, 60))}; ${KNOWN_FILES}`);
      const [, indent, key, text] = found, value = text.replace(/^!!\S+\s*/, "").trim();
      if (indent && inner) {
        values[inner][key] = this.parseScalar(value, at);
      } else if (value === "") values[(inner = key)] = {};
      else [values[key], inner] = [this.parseScalar(value, at), null];
    });
    return values;
  }
  parseScalar(text, at) {
    if (text.startsWith("[")) {
      const list = text.replace(/^\[|\]$/g, "").split(",").map((word) => word.trim()).filter(Boolean).map(Number);
      return text.endsWith("]") && list.every(Number.isFinite) ? list : this.fail(`line ${at + 1}: not a list of numbers`);
    }
    const plain = text.replace(/^(["'])(.*)\1$/, "$2");
    return plain !== "" && plain === text && Number.isFinite(Number(plain)) ? Number(plain) : plain;
  }
}
if (typeof module !== "undefined") module.exports = { LensFile };
