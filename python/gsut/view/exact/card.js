// Draws a frame on the graphics card by WebGPU, with the shaders of forward.wgsl.
"use strict";
const TILE = 16, TILE_PIXELS = 256, CARD_CELL = 4; // as in forward.wgsl
const GROUP = 256, MOST_GROUPS = 65535, RADIX_BITS = 4, KEY_BITS = 32, RECORD_FLOATS = 20;
// Relative: what rounding a radius to float may take from it.
const RADIUS_MARGIN = 1e-6;
// Of the rule that gsut draws by: least alpha, largest alpha, transmittance at which a pixel is closed.
const RULE = { least: 1 / 255, most: 0.99, stop: 1e-4 };
const LARGEST = 3.4e38;
// A part of the Gaussians is a multiple of it: bindings begin at multiples of 256 bytes.
const PART_ROWS = 64;
// Lenses and sizes whose tiles stay on the card.
const KEPT_TILES = 8;
const SHADERS = ["make_records", "count_digits", "scatter", "scan", "order_counts", "list_pairs", "find_tiles", "blend"];

// The rays of a camera by tile: all that a shader knows of a lens.
function cutTiles(core, lens) {
  const { width, height } = lens, tiles = [width, height].map((side) => Math.ceil(side / TILE)), cells = tiles.map((side) => Math.ceil(side / CARD_CELL));
  const centers = new Float64Array(2 * width * height);
  for (let i = 0; i < width * height; i++) centers.set([i % width + 0.5, Math.floor(i / width) + 0.5], 2 * i);
  const camera = core.makeCamera(lens);
  let rays, valid;
  try {
    rays = core.unproject(camera, centers).rays;
    valid = core.validPixels(camera, width * height);
  } finally { core.releaseCamera(camera); }
  const cones = new Float32Array(4 * (cells[0] * cells[1] + tiles[0] * tiles[1]));
  const bound = (at, x0, y0, side) => { // direction and largest distance of a unit ray from it; -1: no ray
    const sum = [0, 0, 0], each = (use) => {
      for (let y = y0; y < Math.min(height, y0 + side); y++) for (let x = x0; x < Math.min(width, x0 + side); x++) if (valid[y * width + x]) use(3 * (y * width + x));
    };
    let radius = -1;
    each((i) => { for (let k = 0; k < 3; k++) sum[k] += rays[i + k]; });
    const norm = Math.hypot(...sum), mean = norm > 0 ? sum.map((value) => Math.fround(value / norm)) : [0, 0, 1];
    each((i) => { radius = Math.max(radius, Math.hypot(rays[i] - mean[0], rays[i + 1] - mean[1], rays[i + 2] - mean[2])); });
    cones.set([...mean, radius < 0 ? -1 : radius * (1 + RADIUS_MARGIN)], 4 * at);
  };
  for (let cell = 0; cell < cells[0] * cells[1]; cell++) bound(cell, cell % cells[0] * TILE * CARD_CELL, Math.floor(cell / cells[0]) * TILE * CARD_CELL, TILE * CARD_CELL);
  const local = new Float32Array(4 * TILE_PIXELS * tiles[0] * tiles[1]), first = cells[0] * cells[1];
  for (let tile = 0; tile < tiles[0] * tiles[1]; tile++) {
    const x0 = tile % tiles[0] * TILE, y0 = Math.floor(tile / tiles[0]) * TILE;
    bound(first + tile, x0, y0, TILE);
    for (let k = 0; k < TILE_PIXELS; k++) {
      const x = x0 + k % TILE, y = y0 + Math.floor(k / TILE), i = y * width + x;
      if (x >= width || y >= height || !valid[i]) continue;
      for (let c = 0; c < 3; c++) local[4 * (TILE_PIXELS * tile + k) + c] = rays[3 * i + c] - cones[4 * (first + tile) + c];
      local[4 * (TILE_PIXELS * tile + k) + 3] = 1;
    }
  }
  return { width, height, tiles, cells, cones, local, valid };
}

class Card {
  // Returns the card, or null where the browser has none.
  static async find(text) {
    const adapter = await navigator.gpu?.requestAdapter({ powerPreference: "high-performance" });
    if (!adapter) return null;
    // A card that the processor computes is slower than the workers; #card in the address takes it, for tests.
    if ((adapter.info?.isFallbackAdapter ?? adapter.isFallbackAdapter) && location.hash !== "#card") return null;
    const card = new Card(), limits = {};
    for (const key of ["maxBufferSize", "maxStorageBufferBindingSize"]) limits[key] = adapter.limits[key];
    card.device = await adapter.requestDevice({ requiredLimits: limits });
    card.most = Math.min(limits.maxBufferSize, limits.maxStorageBufferBindingSize);
    card.lost = false;
    card.device.lost.then(() => (card.lost = true));
    const module = card.device.createShaderModule({ code: text });
    card.pipelines = Object.fromEntries(await Promise.all(SHADERS.map(async (name) => [name, await card.device.createComputePipelineAsync({ layout: "auto", compute: { module, entryPoint: name } })])));
    card.kept = new Map();
    card.passing = [];
    return card;
  }
  // size, coefficients, parts: as Core.setScene takes them.
  setScene({ size, coefficients, parts: [means, quats, scales, logits, sh] }) {
    const splats = new Float32Array(11 * size), parted = []; // parts that fit one binding each
    for (let i = 0; i < size; i++) {
      splats.set(means.subarray(3 * i, 3 * i + 3), 11 * i);
      splats.set(quats.subarray(4 * i, 4 * i + 4), 11 * i + 3);
      splats.set(scales.subarray(3 * i, 3 * i + 3), 11 * i + 7);
      splats[11 * i + 10] = logits[i];
    }
    const width = 3 * coefficients, most = PART_ROWS * Math.max(1, Math.floor(this.most / (4 * Math.max(11, width)) / PART_ROWS));
    for (let first = 0; first < size; first += most) {
      const end = Math.min(size, first + most), cut = (array, each) => this.upload(array.subarray(each * first, each * end));
      parted.push({ first, rows: end - first, splats: cut(splats, 11), sh: cut(sh, width) });
    }
    this.scene?.parted.forEach(({ splats: old, sh: colors }) => [old, colors].forEach((buffer) => buffer.destroy()));
    this.scene = { size, coefficients, parted };
    this.passing = [];
  }
  // Returns { image over black, alpha, depth, valid }; start: camera_from_world, 4 x 4 in rows.
  async draw(core, lens, start, background) {
    const { size, parted } = this.scene, tiles = this.findTiles(core, lens), [across, down] = tiles.tiles, count = across * down;
    if (Math.max(Math.ceil(size / GROUP), count) > MOST_GROUPS) throw new Error("this frame is too large for the card");
    const view = this.describeView(start, tiles), records = this.room(RECORD_FLOATS * size), [keys, values, counts, begin] = [size, size, size, size + 1].map((n) => this.room(n));
    const groups = Math.ceil(size / GROUP), first = this.device.createCommandEncoder(), sum = this.room(4, GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST);
    for (const { first: from, rows, splats, sh } of parted) {
      const rest = (each) => [4 * each * from, 4 * each * rows];
      this.call(first, "make_records", Math.ceil(rows / GROUP), [
        [0, 0, this.describeView(start, tiles, from, rows)], [0, 1, splats], [0, 2, sh], [0, 3, tiles.cones],
        [0, 4, records, ...rest(RECORD_FLOATS)], [0, 5, keys, ...rest(1)], [0, 6, values, ...rest(1)], [0, 7, counts, ...rest(1)],
      ]);
    }
    const [, order] = this.sort(first, keys, values, size, KEY_BITS);
    this.call(first, "order_counts", groups, [[0, 0, view], [0, 7, counts], [1, 6, order], [1, 7, begin]]);
    this.scan(first, begin, size);
    first.copyBufferToBuffer(begin, 4 * size, sum, 0, 4);
    this.device.queue.submit([first.finish()]);
    const pairs = new Uint32Array(await this.read(sum))[0], work = this.device.createCommandEncoder(), tileBegin = this.room(count + 1);
    let listed = this.room(1);
    if (pairs) {
      if (Math.ceil(pairs / GROUP) > MOST_GROUPS) throw new Error("this frame is too large for the card");
      const [tileKeys, gaussians] = [this.room(pairs), this.room(pairs)];
      this.call(work, "list_pairs", groups, [[0, 0, view], [0, 3, tiles.cones], [0, 4, records], [1, 3, tileKeys], [1, 4, gaussians], [1, 6, order], [1, 7, begin]]);
      const [sorted, found] = this.sort(work, tileKeys, gaussians, pairs, 32 - Math.clz32(count));
      this.call(work, "find_tiles", Math.ceil(pairs / GROUP), [[0, 0, view], [1, 0, this.uniform([pairs, 0, 0, 0])], [1, 1, sorted], [1, 8, tileBegin]]);
      listed = found;
    }
    const colors = this.room(4 * TILE_PIXELS * count), along = this.room(4 * TILE_PIXELS * count), back = this.room(8 * TILE_PIXELS * count, GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST);
    this.call(work, "blend", count, [[0, 0, view], [0, 3, tiles.cones], [0, 4, records], [1, 8, tileBegin], [3, 0, tiles.rays], [3, 1, listed], [3, 2, colors], [3, 3, along]]);
    work.copyBufferToBuffer(colors, 0, back, 0, colors.size);
    work.copyBufferToBuffer(along, 0, back, colors.size, along.size);
    this.device.queue.submit([work.finish()]);
    const found = new Float32Array(await this.read(back));
    this.passing.forEach((buffer) => buffer.destroy());
    this.passing = [];
    return this.join(tiles, found, background);
  }
  join({ width, height, tiles, valid }, found, background) {
    const image = new Float32Array(3 * width * height), alpha = new Float32Array(width * height), depth = new Float32Array(width * height), half = found.length / 2;
    for (let i = 0; i < width * height; i++) {
      if (!valid[i]) continue;
      const x = i % width, y = Math.floor(i / width), at = 4 * (TILE_PIXELS * (Math.floor(y / TILE) * tiles[0] + Math.floor(x / TILE)) + y % TILE * TILE + x % TILE), left = found[at + 3];
      for (let k = 0; k < 3; k++) image[3 * i + k] = found[at + k] + left * background[k];
      alpha[i] = 1 - left;
      depth[i] = found[half + at];
    }
    return { image, alpha, depth, valid };
  }
  findTiles(core, lens) {
    const key = JSON.stringify(lens), kept = this.kept.get(key);
    if (kept) return kept;
    const { cones, local, ...rest } = cutTiles(core, lens), tiles = { ...rest, cones: this.upload(cones), rays: this.upload(local) };
    if (this.kept.size >= KEPT_TILES) {
      const [oldest, old] = this.kept.entries().next().value;
      old.cones.destroy();
      old.rays.destroy();
      this.kept.delete(oldest);
    }
    this.kept.set(key, tiles);
    return tiles;
  }
  describeView(m, tiles, first = 0, rows = this.scene.size) { // the shaders' View; the camera's centre keeps the digits that a float takes
    const center = [0, 1, 2].map((k) => -(m[k] * m[3] + m[4 + k] * m[7] + m[8 + k] * m[11])), high = center.map(Math.fround), { coefficients } = this.scene;
    const data = new ArrayBuffer(128);
    new Float32Array(data, 0, 24).set([...high, Math.log2(RULE.least), ...center.map((value, k) => value - high[k]), LARGEST, m[0], m[1], m[2], RULE.most, m[4], m[5], m[6], RULE.stop, m[8], m[9], m[10], 0, -LARGEST, LARGEST, 0, 0]);
    new Uint32Array(data, 96).set([rows, ...tiles.tiles, Math.round(Math.sqrt(coefficients)) - 1, ...tiles.cells, coefficients, first]);
    return this.uniform(data);
  }
  sort(work, keys, values, count, bits) { // stably by the lowest bits of the keys
    const blocks = Math.ceil(count / GROUP), counts = this.room((1 << RADIX_BITS) * blocks + 1);
    let now = [keys, values], spare = [this.room(count), this.room(count)];
    for (let shift = 0; shift < bits; shift += RADIX_BITS) {
      const what = this.uniform([count, shift, blocks, 0]);
      this.call(work, "count_digits", blocks, [[1, 0, what], [1, 1, now[0]], [1, 5, counts]]);
      this.scan(work, counts, (1 << RADIX_BITS) * blocks);
      this.call(work, "scatter", blocks, [[1, 0, what], [1, 1, now[0]], [1, 2, now[1]], [1, 3, spare[0]], [1, 4, spare[1]], [1, 5, counts]]);
      [now, spare] = [spare, now];
    }
    return now;
  }
  scan(work, sums, count) { this.call(work, "scan", 1, [[2, 0, this.uniform([count, 0, 0, 0])], [2, 1, sums]]); }
  call(work, shader, groups, bindings) { // bindings: [group, binding, buffer], of a part also its offset and size
    const pipeline = this.pipelines[shader], pass = work.beginComputePass();
    pass.setPipeline(pipeline);
    for (const group of new Set(bindings.map(([where]) => where))) {
      const entries = bindings.filter(([where]) => where === group).map(([, binding, buffer, offset = 0, size]) => ({ binding, resource: { buffer, offset, size } }));
      pass.setBindGroup(group, this.device.createBindGroup({ layout: pipeline.getBindGroupLayout(group), entries }));
    }
    pass.dispatchWorkgroups(groups);
    pass.end();
  }
  room(count, usage = GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_SRC) { // of numbers of 4 bytes, until the frame is done
    const size = 4 * Math.max(4, count);
    if (size > this.most) throw new Error("the card has no room for this frame");
    const buffer = this.device.createBuffer({ size, usage });
    this.passing.push(buffer);
    return buffer;
  }
  upload(array) {
    if (array.byteLength > this.most) throw new Error("the card has no room for this scene");
    const buffer = this.device.createBuffer({ size: Math.max(16, array.byteLength), usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST });
    this.device.queue.writeBuffer(buffer, 0, array);
    return buffer;
  }
  uniform(numbers) {
    const data = numbers instanceof ArrayBuffer ? numbers : Uint32Array.from(numbers), buffer = this.device.createBuffer({ size: data.byteLength, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
    this.device.queue.writeBuffer(buffer, 0, data);
    this.passing.push(buffer);
    return buffer;
  }
  async read(buffer) {
    await buffer.mapAsync(GPUMapMode.READ);
    const data = buffer.getMappedRange().slice(0);
    buffer.unmap();
    return data;
  }
}
