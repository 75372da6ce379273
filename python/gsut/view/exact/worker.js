// Draws rows of tiles in a thread of its own: one core and one copy of the scene each.
"use strict";
// Most pixels of the cameras that are kept; each holds 40 bytes a pixel.
const KEPT_PIXELS = 4e6;

let core;
const cameras = new Map(); // text of a lens and its size -> { handle, pixels }, least recently used first

function findCamera(lens) {
  const key = JSON.stringify(lens), kept = cameras.get(key);
  cameras.delete(key);
  const camera = kept ?? { handle: core.makeCamera(lens), pixels: lens.width * lens.height };
  cameras.set(key, camera);
  let pixels = [...cameras.values()].reduce((sum, each) => sum + each.pixels, 0);
  for (const [old, { handle, pixels: fewer }] of cameras) {
    if (pixels <= KEPT_PIXELS || old === key) break;
    core.releaseCamera(handle);
    cameras.delete(old);
    pixels -= fewer;
  }
  return camera.handle;
}

const TASKS = {
  async start({ bytes, size, coefficients, parts }) {
    core = await Core.load(bytes);
    core.setScene(size, coefficients, parts);
  },
  // rows: of tiles, [begin, end); returns the pixels of these rows.
  draw({ lens, rows, ...job }) {
    const began = performance.now(), { width, height } = lens, camera = findCamera(lens);
    const columns = Math.ceil(width / 16), tiles = new Uint8Array(columns * Math.ceil(height / 16));
    tiles.fill(1, columns * rows[0], columns * rows[1]);
    const whole = core.render(camera, { width, height, tiles, ...job });
    const [begin, end] = rows.map((row) => width * Math.min(height, 16 * row));
    const cut = (array, channels) => array && array.slice(channels * begin, channels * end);
    const valid = cut(core.validPixels(camera, width * height), 1);
    return { rows, image: cut(whole.image, 3), alpha: cut(whole.alpha, 1), depth: cut(whole.depth, 1), valid, ms: performance.now() - began };
  },
};

onmessage = async ({ data: { id, task, values } }) => {
  try {
    const value = await TASKS[task](values);
    postMessage({ id, value }, Object.values(value ?? {}).filter(ArrayBuffer.isView).map((array) => array.buffer));
  } catch (error) {
    postMessage({ id, error: error.message });
  }
};
