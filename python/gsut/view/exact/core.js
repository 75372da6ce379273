// Loads the C++ core compiled to WebAssembly and calls its C functions (cpp/wasm/core.cpp).
"use strict";

class Core {
  // bytes: of core.wasm, not compressed.
  static async load(bytes) {
    const core = new Core();
    const wasi = { // what the C library of the module asks of its host
      clock_time_get: (id, precision, at) => { core.view().setBigUint64(at, BigInt(Math.round(1e6 * performance.now())), true); return 0; },
      environ_sizes_get: (count, size) => { core.view().setUint32(count, 0, true); core.view().setUint32(size, 0, true); return 0; },
      environ_get: () => 0,
      proc_exit: (status) => { throw new Error(`the renderer ended with status ${status}: memory is short`); },
    };
    const { instance } = await WebAssembly.instantiate(bytes, { wasi_snapshot_preview1: wasi, env: { emscripten_notify_memory_growth() {} } });
    core.c = instance.exports;
    core.c._initialize();
    return core;
  }

  // --- memory: views end when it grows, so each use makes its own ---
  view() { return new DataView(this.c.memory.buffer); }
  floats(at, count) { return new Float32Array(this.c.memory.buffer, at, count); }
  doubles(at, count) { return new Float64Array(this.c.memory.buffer, at, count); }
  bytes(at, count) { return new Uint8Array(this.c.memory.buffer, at, count); }
  text(at) {
    const all = this.bytes(at, this.c.memory.buffer.byteLength - at);
    return new TextDecoder().decode(all.slice(0, all.indexOf(0)));
  }
  // Calls work(put), where put(array) copies an array and put(bytes) makes room, until work returns.
  borrow(work) {
    const taken = [];
    const put = (what) => {
      const data = typeof what === "string" ? new TextEncoder().encode(what + "\0") : what;
      const size = typeof data === "number" ? data : data.byteLength;
      const at = this.c.web_allocate(Math.max(8, size));
      if (!at) throw new Error(`${size.toLocaleString()} bytes of memory are not there`);
      taken.push(at);
      if (typeof data !== "number") this.bytes(at, size).set(new Uint8Array(data.buffer, data.byteOffset, size));
      return at;
    };
    try { return work(put); } finally { taken.forEach((at) => this.c.web_free(at)); }
  }
  check(status) { // of a C function
    if (status < 0) throw new Error(this.text(this.c.web_error()));
    return status;
  }

  // --- cameras ---
  models() { return JSON.parse(this.text(this.c.web_models())); }
  isa() { return this.text(this.c.web_isa()); }
  makeCamera({ model, params, width, height, valid_field_angle: angle }) {
    return this.borrow((put) => this.check(this.c.web_make_camera(put(model), params.length, put(Float64Array.from(params)), width, height, angle ?? Infinity)));
  }
  readCamera(text, name) { return this.borrow((put) => this.check(this.c.web_read_camera(put(text), put(name)))); }
  resizeCamera(camera, width, height) { return this.check(this.c.web_resize_camera(camera, width, height)); }
  releaseCamera(camera) { this.check(this.c.web_release_camera(camera)); }
  describeCamera(camera) {
    const at = this.c.web_describe_camera(camera);
    return JSON.parse(this.text(at || this.check(-1)));
  }
  validPixels(camera, count) { // which have a ray
    return this.bytes(this.c.web_valid_pixels(camera) || this.check(-1), count).slice();
  }
  project(camera, points) { // flat (n, 3) -> { pixels: flat (n, 2), valid }
    const count = points.length / 3;
    return this.borrow((put) => {
      const from = put(Float64Array.from(points)), pixels = put(16 * count), valid = put(count);
      this.check(this.c.web_project(camera, count, from, pixels, valid));
      return { pixels: this.doubles(pixels, 2 * count).slice(), valid: this.bytes(valid, count).slice() };
    });
  }
  unproject(camera, pixels) { // flat (n, 2) -> { origins, rays: flat (n, 3), valid }
    const count = pixels.length / 2;
    return this.borrow((put) => {
      const from = put(Float64Array.from(pixels)), origins = put(24 * count), rays = put(24 * count), valid = put(count);
      this.check(this.c.web_unproject(camera, count, from, origins, rays, valid));
      return { origins: this.doubles(origins, 3 * count).slice(), rays: this.doubles(rays, 3 * count).slice(), valid: this.bytes(valid, count).slice() };
    });
  }

  // --- the scene ---
  // parts: means, quats, log_scales, opacity_logits, sh as Float32Array, in this order.
  setScene(size, coefficients, parts) {
    let at = this.c.web_make_scene(size, coefficients) || this.check(-1);
    for (const part of parts) {
      this.floats(at, part.length).set(part);
      at += 4 * part.length;
    }
  }
  // Fills what is open of an image over black, in place; valid: which pixels have a ray.
  fillSurroundings({ width, height, image, alpha, valid }) {
    this.borrow((put) => {
      const at = put(image);
      this.check(this.c.web_fill_surroundings(width, height, at, put(alpha), put(valid)));
      image.set(this.floats(at, image.length));
    });
  }
  // Returns { image, alpha, depth } as Float32Array; alpha and depth only where wanted.
  render(camera, { width, height, start, end = start, shutter = "global", background = [0, 0, 0], tiles = null, alpha: covered = false, depth = false }) {
    return this.borrow((put) => {
      const pixels = width * height, image = put(12 * pixels), alpha = covered || depth ? put(4 * pixels) : 0, far = depth ? put(4 * pixels) : 0;
      const poses = [start, end].map((pose) => put(Float64Array.from(pose)));
      this.check(this.c.web_render(camera, ...poses, put(shutter), put(Float64Array.from(background)), tiles ? put(tiles) : 0, image, alpha, far));
      const copy = (at, count) => (at ? this.floats(at, count).slice() : null);
      return { image: copy(image, 3 * pixels), alpha: copy(alpha, pixels), depth: copy(far, pixels) };
    });
  }
}
if (typeof module !== "undefined") module.exports = { Core };
