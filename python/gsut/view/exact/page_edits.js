// Applies edits by hand to the Gaussians of a page, as gsut's hand_edits.py does.
"use strict";
// Opacity logit of a deleted Gaussian, which no pixel shows.
const DELETED_LOGIT = -20;
// Colour of selected Gaussians as SPZ stores it, and its share in theirs, as shown_gaussians.py has them.
const SELECTED_COLOR = [1, 0.6, 0].map((value) => 255 * (0.5 + 0.15 * (value - 0.5) / 0.28209479177387814)), SELECTED_SHARE = 0.7;

const isInPolygon = (x, y, points) => {
  let inside = false;
  points.forEach(([ax, ay], k) => {
    const [bx, by] = points[(k + 1) % points.length];
    if (ay > y !== by > y && x < (bx - ax) * (y - ay) / (by - ay) + ax) inside = !inside;
  });
  return inside;
};
const isNearLine = (x, y, points, radius) => points.some(([ax, ay], k) => {
  const [bx, by] = points[Math.min(k + 1, points.length - 1)], [wx, wy, dx, dy] = [bx - ax, by - ay, x - ax, y - ay], square = wx * wx + wy * wy;
  const along = square > 0 ? Math.max(0, Math.min(1, (dx * wx + dy * wy) / square)) : 0;
  return (dx - along * wx) ** 2 + (dy - along * wy) ** 2 <= radius * radius;
});

class PageEdits {
  constructor(server) {
    this.server = server;
    this.done = []; // { text of the step, kept, selected } of the edits that are applied
  }
  describe({ frame, ...step }) { // as the file of edits holds it
    if (!frame) return step;
    const { server } = this, { pose, width, height, turns = 0, lens: number } = { ...asStored(frame), turns: frame.turns }, m = placeAbout(pose, server.content.offset.map((value) => -value));
    const { turns: _, ...lens } = server.resize(number, width, height);
    return { ...step, camera_from_world: [0, 4, 8, 12].map((k) => m.slice(k, k + 4)), lens, points: step.points.map((at) => turnedBack(at, width, height, turns)) };
  }
  get state() { return this.done.at(-1) ?? { kept: new Uint8Array(this.server.gaussians.size).fill(1), selected: new Uint8Array(this.server.gaussians.size) }; }
  async apply(steps) {
    const texts = steps.map((step) => JSON.stringify(step)), same = texts.findIndex((text, k) => this.done[k]?.text !== text);
    this.done.length = Math.min(this.done.length, same < 0 ? texts.length : same);
    await this.paint();
    for (let k = this.done.length; k < steps.length; k++) {
      this.done.push({ text: texts[k], ...(await this.applyOne(steps[k])) });
      await this.paint();
    }
    const { kept, selected } = this.state, count = (marks) => marks.reduce((sum, mark) => sum + mark, 0);
    return { key: steps.length ? texts.join() : null, selected: count(selected), kept: count(kept), of: kept.length };
  }
  async applyOne(step) {
    const { kept, selected } = this.state, none = new Uint8Array(kept.length);
    if (step.do === "delete") return { kept: kept.map((mark, i) => mark & ~selected[i]), selected: none };
    if (step.do === "keep") return { kept: selected.some(Boolean) ? selected : kept, selected: none };
    if (step.do === "clear") return { kept, selected: none };
    const found = await this.findInRegion(step, kept);
    return { kept, selected: selected.map((mark, i) => (step.subtract ? mark & ~found[i] : mark | found[i])) };
  }
  async findInRegion(step, kept) { // marks of the Gaussians whose centres lie in it
    const { server } = this, { size, parts: [means, , scales] } = server.gaussians, { lens, points, radius, front, camera_from_world: rows } = this.describe(step);
    const m = placeAbout(rows.flat(), server.content.origin.map((value, k) => value + server.content.offset[k])), places = new Float64Array(3 * size), found = new Uint8Array(size);
    for (let i = 0; i < size; i++) for (let k = 0; k < 3; k++) places[3 * i + k] = m[4 * k] * means[3 * i] + m[4 * k + 1] * means[3 * i + 1] + m[4 * k + 2] * means[3 * i + 2] + m[4 * k + 3];
    const { pixels, valid } = server.borrow(lens, (camera) => server.core.project(camera, places)), reach = radius ?? 0;
    const [low, high] = [Math.min, Math.max].map((most, k) => [0, 1].map((c) => points.reduce((edge, at) => most(edge, at[c]), k ? 0 : Infinity) + (k ? reach : -reach)));
    const seen = front ? await server.draw(asStored(step.frame), true) : null;
    for (let i = 0; i < size; i++) {
      const [x, y] = [pixels[2 * i], pixels[2 * i + 1]];
      if (!valid[i] || !kept[i] || !(x >= Math.max(0, low[0]) && x <= Math.min(lens.width, high[0]) && y >= Math.max(0, low[1]) && y <= Math.min(lens.height, high[1]))) continue;
      if (!(radius === undefined ? isInPolygon(x, y, points) : isNearLine(x, y, points, radius))) continue;
      if (seen) {
        const at = Math.min(lens.height - 1, Math.floor(y)) * lens.width + Math.min(lens.width - 1, Math.floor(x)), far = seen.alpha[at] > SEEN ? seen.depth[at] / seen.alpha[at] : Infinity;
        if (Math.hypot(places[3 * i], places[3 * i + 1], places[3 * i + 2]) > far + Math.exp(Math.max(...scales.subarray(3 * i, 3 * i + 3)))) continue;
      }
      found[i] = 1;
    }
    return found;
  }
  async paint() { // what draws shows the edits
    const { server, state: { kept, selected } } = this, { size, coefficients, stored, parts: [means, quats, scales, logits, sh] } = server.gaussians;
    if (this.painted === this.state.text) return;
    this.painted = this.state.text;
    const shown = logits.map((value, i) => (kept[i] ? value : DELETED_LOGIT)), colors = stored.colors.map((value, at) => (selected[Math.floor(at / 3)] ? (1 - SELECTED_SHARE) * value + SELECTED_SHARE * SELECTED_COLOR[at % 3] : value));
    const first = Float32Array.from(colors, toFirstHarmonic), all = sh.slice();
    for (let i = 0; i < size; i++) all.set(first.subarray(3 * i, 3 * i + 3), 3 * coefficients * i);
    const scene = { size, coefficients, stored: { ...stored, colors }, parts: [means, quats, scales, shown, all] };
    await server.inTurn(() => server.card?.setScene(scene));
    server.moving?.upload(scene);
    await Promise.all(server.workers.map(({ send }) => send("paint", { logits: shown, colors: first })));
  }
  writeScene() { // a PLY of what is kept, as gsut writes it
    const { server, state: { kept } } = this, { coefficients, antialiased, parts: [means, quats, scales, logits, sh] } = server.gaussians, { origin } = server.content;
    const rest = 3 * (coefficients - 1), list = (name, count) => Array.from({ length: count }, (_, k) => `${name}_${k}`);
    const names = ["x", "y", "z", ...list("f_dc", 3), ...list("f_rest", rest), "opacity", ...list("scale", 3), ...list("rot", 4)], rows = [];
    kept.forEach((mark, i) => {
      if (!mark) return;
      const own = sh.subarray(3 * coefficients * i, 3 * coefficients * (i + 1)), higher = Array.from({ length: rest }, (_, k) => own[3 + 3 * (k % (coefficients - 1)) + Math.floor(k / (coefficients - 1))]);
      rows.push(Float32Array.of(...means.subarray(3 * i, 3 * i + 3), ...own.subarray(0, 3), ...higher, logits[i], ...scales.subarray(3 * i, 3 * i + 3), ...quats.subarray(4 * i, 4 * i + 4)));
    });
    const comments = ["written by gsut", `SplatRenderMode: ${antialiased ? "mip" : "default"}`, ...(origin.some(Boolean) ? [`gsut: dataset coordinates = these + ${origin.join(" ")}`] : [])];
    const head = ["ply", "format binary_little_endian 1.0", ...comments.map((text) => `comment ${text}`), `element vertex ${rows.length}`, ...names.map((name) => `property float ${name}`), "end_header", ""].join("\n");
    return new Blob([head, ...rows]);
  }
}
