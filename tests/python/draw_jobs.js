// Draws scenes by the WebAssembly core in node: jobs.json and numbers.bin in, images.bin out; of jobs with
// runs, times.json holds the least milliseconds of so many more frames, by the clock and of the processor.
const fs = require("fs");
const path = require("path");
const zlib = require("zlib");

const [folder, coreFolder] = process.argv.slice(2);
const { Core } = require(path.join(coreFolder, "core.js"));

(async () => {
  const core = await Core.load(zlib.gunzipSync(fs.readFileSync(path.join(coreFolder, "core.wasm.gz"))));
  const jobs = JSON.parse(fs.readFileSync(path.join(folder, "jobs.json")));
  const file = fs.readFileSync(path.join(folder, "numbers.bin"));
  const numbers = new Float32Array(file.buffer, file.byteOffset, file.byteLength / 4);
  const out = fs.openSync(path.join(folder, "images.bin"), "w");
  const times = [];
  let at = 0;
  for (const job of jobs) {
    const parts = [3, 4, 3, 1, 3 * job.coefficients].map((each) => numbers.subarray(at, (at += each * job.size)));
    core.setScene(job.size, job.coefficients, parts);
    const camera = core.makeCamera(job.camera);
    const whole = core.render(camera, { ...job.camera, ...job, depth: true });
    for (const array of [whole.image, whole.alpha, whole.depth]) fs.writeSync(out, new Uint8Array(array.buffer));
    // Half the rows of tiles each, as two workers draw them.
    const [columns, rows] = [job.camera.width, job.camera.height].map((side) => Math.ceil(side / 16));
    const joined = new Float32Array(whole.image.length);
    const cut = Math.min(joined.length, 16 * Math.ceil(rows / 2) * job.camera.width * 3);
    for (const half of [0, 1]) {
      const tiles = new Uint8Array(rows * columns).map((_, tile) => (Math.floor(tile / columns) < Math.ceil(rows / 2)) === !half);
      const part = core.render(camera, { ...job.camera, ...job, tiles }).image;
      if (half) joined.set(part.subarray(cut), cut);
      else joined.set(part.subarray(0, cut));
    }
    fs.writeSync(out, new Uint8Array(joined.buffer));
    if (job.runs) {
      const frames = Array.from({ length: job.runs }, () => {
        const began = performance.now(), used = process.cpuUsage();
        core.render(camera, { ...job.camera, ...job, alpha: true });
        const { user, system } = process.cpuUsage(used);
        return [performance.now() - began, (user + system) / 1e3];
      });
      times.push([0, 1].map((k) => Math.min(...frames.map((frame) => frame[k]))));
    }
    core.releaseCamera(camera);
  }
  fs.writeFileSync(path.join(folder, "times.json"), JSON.stringify(times));
  fs.closeSync(out);
})().catch((error) => { console.error(error.message); process.exit(1); });
