// Draws frames of a moving eye by WebGL 2, with the shaders of moving.glsl.
"use strict";
// Nodes along a side of the table of a lens, and what it reaches beyond the image, of its own reach.
const NODES = 129, CHART_MARGIN = 1.25;
// Pixels along a side at which a lens is asked which directions it sees.
const SEEN_SAMPLES = 33;
// How a direction without a pixel comes nearer to the axis until it has one, and how often.
const NEARER = 0.9, MOST_NEARER = 60;
// Of the rule that gsut draws by: least alpha and largest alpha.
const RULE = { least: 1 / 255, most: 0.99 };
// Pixels between those whose rays are computed; the others lie between them.
const RAY_STEP = 4;
// Texels across a table of Gaussians, harmonics or their order.
const TABLE_WIDTH = 2048;
// Lenses and sizes whose tables stay on the card.
const KEPT_TABLES = 8;
// Sine of the angle between the rays of the left and the right edge below which a lens is a panorama.
const SAME_RAY = 1e-3;
// Square of the tangent of a Gaussian's angular radius above which a lens is not linear across it.
const WIDE = 0.2;
// Margin of a quad where the lens is taken to be linear.
const LINEAR_MARGIN = 1.06;
// Alpha above which a pixel is closed, and the shares of the Gaussians after which closed ones are left out.
const CLOSED = 0.997, SHARES_DRAWN = [0, 0.03, 0.08, 0.16, 0.3, 0.5, 1];
// Textures, by the unit that each has.
const UNITS = ["gaussians", "harmonics", "order", "lens", "rays", "picture"];
// Names of cards that the processor computes.
const COMPUTED_CARD = /swiftshader|llvmpipe|software|basic render/i;

// Where directions fall on the image: { span, nodes, around }; see moving.glsl.
function chartLens(core, lens) {
  const { width, height } = lens, places = [], last = SEEN_SAMPLES - 1;
  for (let i = 0; i < SEEN_SAMPLES ** 2; i++) places.push(width * (i % SEEN_SAMPLES) / last, height * Math.floor(i / SEEN_SAMPLES) / last);
  const ask = (which, work) => {
    const camera = core.makeCamera(which);
    try { return work(camera); } finally { core.releaseCamera(camera); }
  };
  const [seen, edges] = ask(lens, (camera) => [core.unproject(camera, places), core.unproject(camera, [1e-3, height / 2, width - 1e-3, height / 2])]);
  const reach = seen.valid.reduce((most, ok, k) => {
    const [x, y, z] = seen.rays.subarray(3 * k, 3 * k + 3);
    return ok ? Math.max(most, z > 0 ? Math.hypot(x, y) / (1 + z) : 1) : most;
  }, 1e-3);
  const span = Math.min(1.001, CHART_MARGIN * reach), count = 2 * NODES ** 2, nodes = new Float32Array(4 * count);
  let open = Array.from({ length: count }, (_, i) => {
    const across = i % (2 * NODES), [x, y] = [across % NODES, Math.floor(i / (2 * NODES))].map((k) => span * (2 * k / (NODES - 1) - 1));
    return { i, x, y, ahead: across < NODES ? 1 : -1 };
  });
  ask({ ...lens, valid_field_angle: null }, (camera) => { // Gaussians beyond the rim reach over it
    for (let round = 0; open.length && round < MOST_NEARER; round++) {
      const found = core.project(camera, open.flatMap(({ x, y, ahead }) => [2 * x, 2 * y, (1 - x * x - y * y) * ahead]));
      open = open.filter((node, k) => {
        if (found.valid[k]) nodes.set([found.pixels[2 * k], found.pixels[2 * k + 1], round ? 0 : 1], 4 * node.i);
        const nearer = node.ahead < 0 ? span / Math.max(1e-9, Math.hypot(node.x, node.y)) : NEARER;
        Object.assign(node, { x: node.x * nearer, y: node.y * nearer, ahead: 1 });
        return !found.valid[k];
      });
    }
  });
  const [l, r] = [edges.rays.subarray(0, 3), edges.rays.subarray(3)], apart = Math.hypot(l[1] * r[2] - l[2] * r[1], l[2] * r[0] - l[0] * r[2], l[0] * r[1] - l[1] * r[0]);
  const meets = edges.valid.every(Boolean) && l[0] * r[0] + l[1] * r[1] + l[2] * r[2] > 0 && apart < SAME_RAY;
  return { span, nodes, around: meets ? width : 0 };
}

// Rays of the pixels of a camera, (height, width, 4) with the lowest row first; the last is 0 where there is none.
function findRays(core, camera, width, height) {
  const across = Math.ceil(width / RAY_STEP) + 1, down = Math.ceil(height / RAY_STEP) + 1, out = new Float32Array(4 * width * height), alone = [];
  const places = Array.from({ length: 2 * across * down }, (_, i) => (i % 2 ? Math.min(height, RAY_STEP * Math.floor((i >> 1) / across)) : Math.min(width, RAY_STEP * ((i >> 1) % across))));
  const { rays, valid } = core.unproject(camera, places), at = (x, y) => 4 * ((height - 1 - y) * width + x);
  for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
    const node = Math.floor(y / RAY_STEP) * across + Math.floor(x / RAY_STEP), four = [node, node + 1, node + across, node + across + 1];
    const seen = valid[four[0]] + valid[four[1]] + valid[four[2]] + valid[four[3]], [x0, y0] = [places[2 * node], places[2 * node + 1]];
    if (seen < 4) { if (seen) alone.push([x, y]); continue; }
    const fx = (x + 0.5 - x0) / (places[2 * four[3]] - x0), fy = (y + 0.5 - y0) / (places[2 * four[3] + 1] - y0), to = at(x, y);
    for (let k = 0; k < 3; k++) out[to + k] = (1 - fy) * ((1 - fx) * rays[3 * four[0] + k] + fx * rays[3 * four[1] + k]) + fy * ((1 - fx) * rays[3 * four[2] + k] + fx * rays[3 * four[3] + k]);
    out[to + 3] = 1;
  }
  const found = core.unproject(camera, alone.flatMap(([x, y]) => [x + 0.5, y + 0.5]));
  alone.forEach(([x, y], k) => found.valid[k] && out.set([...found.rays.subarray(3 * k, 3 * k + 3), 1], at(x, y)));
  return out;
}

class MovingPicture {
  // Returns null where the browser has no WebGL 2, or it has no room for the scene.
  static find(shader, code, scene) {
    const canvas = document.createElement("canvas"), gl = canvas.getContext("webgl2", { antialias: false, depth: false, preserveDrawingBuffer: true, powerPreference: "high-performance" });
    const named = gl?.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL ?? gl?.RENDERER;
    // A card that the processor computes is slower than the workers; #card in the address takes it, for tests.
    if (!gl || (COMPUTED_CARD.test(gl.getParameter(named)) && location.hash !== "#card")) return null;
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (most < TABLE_WIDTH || scene.size * Math.max(3, scene.coefficients) > TABLE_WIDTH * (most - 1)) return null;
    const picture = Object.assign(new MovingPicture(), { canvas, gl, shader, kept: new Map(), from: "", corners: 0 });
    picture.float = gl.getExtension("EXT_color_buffer_float") ?? gl.getExtension("EXT_color_buffer_half_float");
    picture.quads = picture.build("QUADS", "RESPONSE");
    picture.close = picture.build("SCREEN", "CLOSE");
    picture.present = picture.build("SCREEN", "SHOW");
    picture.upload(scene);
    picture.worker = new Worker(URL.createObjectURL(new Blob([code], { type: "text/javascript" })));
    picture.worker.postMessage({ means: scene.parts[0] });
    return picture;
  }
  get lost() { return this.gl.isContextLost(); }
  build(vertex, fragment) { // returns set(name, kind, ...values) of uniforms, which also takes the program into use
    const { gl } = this, program = gl.createProgram();
    const numbers = Object.entries({ LEAST: RULE.least, MOST: RULE.most, WIDE, LINEAR_MARGIN, CLOSED }).map(([name, value]) => `#define ${name} ${value}\n`).join("");
    for (const [kind, name] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const built = gl.createShader(kind);
      gl.shaderSource(built, `#version 300 es\nprecision highp float;\nprecision highp int;\n#define ${name}\n#define NODES ${NODES}\n${numbers}${this.shader}`);
      gl.compileShader(built);
      gl.attachShader(program, built);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(`WebGL 2: ${gl.getProgramInfoLog(program) ?? "no shader"}`);
    gl.useProgram(program);
    UNITS.forEach((name, unit) => gl.uniform1i(gl.getUniformLocation(program, name), unit));
    return (name, kind, ...values) => { gl.useProgram(program); gl[`uniform${kind}`](gl.getUniformLocation(program, name), ...values); };
  }
  table(name, kind, format, type, data, width = TABLE_WIDTH) { // makes a texture of data, whose length is whole rows
    const { gl } = this, each = { [gl.RED_INTEGER]: 1, [gl.RGB]: 3, [gl.RGBA]: 4 }[format], texture = gl.createTexture();
    this.bind(name, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, kind, width, data.length / each / width, 0, format, type, data);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
    return texture;
  }
  bind(name, texture) {
    this.gl.activeTexture(this.gl.TEXTURE0 + UNITS.indexOf(name));
    this.gl.bindTexture(this.gl.TEXTURE_2D, texture);
  }
  upload({ size, coefficients, stored, parts: [means, quats, scales, logits] }) {
    const { gl } = this, whole = (texels) => TABLE_WIDTH * Math.ceil(texels / TABLE_WIDTH), numbers = new Float32Array(4 * whole(3 * size)), bytes = new Uint8Array(3 * whole(coefficients * size)), rest = 3 * (coefficients - 1);
    for (let i = 0; i < size; i++) {
      const [w, x, y, z] = quats.subarray(4 * i, 4 * i + 4);
      numbers.set([...means.subarray(3 * i, 3 * i + 3), 1 / (1 + Math.exp(-logits[i])), x, y, z, w, ...scales.subarray(3 * i, 3 * i + 3).map(Math.exp)], 12 * i);
      bytes.set(stored.colors.subarray(3 * i, 3 * i + 3), 3 * coefficients * i);
      bytes.set(stored.rest.subarray(rest * i, rest * (i + 1)), 3 * coefficients * i + 3);
    }
    this.size = size;
    this.table("gaussians", gl.RGBA32F, gl.RGBA, gl.FLOAT, numbers);
    this.table("harmonics", gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE, bytes);
    this.table("order", gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT, new Uint32Array(whole(size)));
    this.quads("coefficients", "1i", coefficients);
  }
  keep(key, make) { // what make() returns, of the latest keys
    const { kept } = this, found = kept.get(key) ?? make();
    kept.delete(key);
    kept.set(key, found);
    if (kept.size > KEPT_TABLES) {
      const [oldest, { texture }] = kept.entries().next().value;
      this.gl.deleteTexture(texture);
      kept.delete(oldest);
    }
    return found;
  }
  useLens(core, lens, width, height) { // returns { span, around } of its chart
    const { gl } = this, key = JSON.stringify(lens);
    const chart = this.keep(key, () => {
      const { nodes, ...rest } = chartLens(core, lens);
      return { ...rest, texture: this.table("lens", gl.RGBA32F, gl.RGBA, gl.FLOAT, nodes, 2 * NODES) };
    });
    const rays = this.keep(`${width} ${height} ${key}`, () => {
      const camera = core.makeCamera(lens), resized = core.resizeCamera(camera, width, height);
      try { return { texture: this.table("rays", gl.RGBA32F, gl.RGBA, gl.FLOAT, findRays(core, resized, width, height), width) }; } finally { [camera, resized].forEach((each) => core.releaseCamera(each)); }
    });
    this.bind("lens", chart.texture);
    this.bind("rays", rays.texture);
    return chart;
  }
  resize(width, height) { // the targets: the picture, and the depth that closes its pixels
    const { gl, canvas } = this;
    if (this.picture && canvas.width === width && canvas.height === height) return;
    Object.assign(canvas, { width, height });
    gl.deleteTexture(this.picture);
    gl.deleteRenderbuffer(this.depth);
    this.bind("picture", (this.picture = gl.createTexture()));
    gl.texStorage2D(gl.TEXTURE_2D, 1 + Math.floor(Math.log2(Math.max(width, height))), this.float ? gl.RGBA16F : gl.RGBA8, width, height);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.bindRenderbuffer(gl.RENDERBUFFER, (this.depth = gl.createRenderbuffer()));
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT16, width, height);
    this.targets ??= [gl.createFramebuffer(), gl.createFramebuffer()];
    for (const target of this.targets) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, this.depth);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.targets[0]);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.picture, 0);
  }
  async order(center) { // uploads the Gaussians' order from there
    const { gl } = this, key = String(center);
    if (this.from === key) return;
    const order = await new Promise((done) => { this.worker.onmessage = ({ data }) => done(data); this.worker.postMessage({ center }); });
    gl.activeTexture(gl.TEXTURE0 + UNITS.indexOf("order"));
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TABLE_WIDTH, order.length / TABLE_WIDTH, gl.RED_INTEGER, gl.UNSIGNED_INT, order);
    this.from = key;
  }
  drawQuads(copies) {
    const { gl, size, targets: [picture, closing] } = this, count = copies * size;
    if (this.corners < count) { // two triangles of four corners each
      const corners = new Uint32Array(6 * count);
      for (let i = 0; i < count; i++) corners.set([4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 2, 4 * i + 1, 4 * i + 3], 6 * i);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
      this.corners = count;
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, picture);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    SHARES_DRAWN.slice(1).forEach((share, k) => {
      const [begin, end] = [SHARES_DRAWN[k], share].map((part) => Math.round(part * count));
      if (k) {
        gl.bindFramebuffer(gl.FRAMEBUFFER, closing);
        gl.disable(gl.BLEND);
        gl.depthMask(true);
        gl.depthFunc(gl.ALWAYS);
        this.close("picture", "1i", UNITS.indexOf("picture"));
        gl.drawArrays(gl.TRIANGLES, 0, 3);
        gl.bindFramebuffer(gl.FRAMEBUFFER, picture);
      }
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE_MINUS_DST_ALPHA, gl.ONE);
      gl.depthMask(false);
      gl.depthFunc(gl.LESS);
      this.quads("copies", "1i", copies);
      gl.drawElements(gl.TRIANGLES, 6 * (end - begin), gl.UNSIGNED_INT, 24 * begin);
    });
  }
  // Returns a canvas with the frame; m: camera_from_world, 4 x 4 in rows; background: null for the surroundings.
  async draw(core, lens, m, width, height, background) {
    const { gl, canvas } = this, center = [0, 1, 2].map((k) => -(m[k] * m[3] + m[4 + k] * m[7] + m[8 + k] * m[11]));
    await this.order(center);
    const { span, around } = this.useLens(core, lens, width, height);
    this.resize(width, height);
    gl.viewport(0, 0, width, height);
    this.quads("rotation", "Matrix3fv", false, [m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]]);
    this.quads("center", "3f", ...center);
    this.quads("size", "2f", width, height);
    this.quads("scale", "2f", width / lens.width, height / lens.height);
    this.quads("span", "1f", span);
    this.quads("around", "1f", around);
    this.drawQuads(around ? 2 : 1);
    if (!background) {
      this.bind("picture", this.picture);
      gl.generateMipmap(gl.TEXTURE_2D);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.disable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    this.present("background", "4f", ...(background ?? [0, 0, 0]), background ? 1 : 0);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    while (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) await new Promise((done) => setTimeout(done, 1));
    gl.deleteSync(fence);
    return canvas;
  }
}
