// Draws scenes by the WebAssembly core. In node: jobs.json and numbers.bin in, images.bin out; of jobs with
// runs, times.json holds the least milliseconds of so many more frames, by the clock and of the processor.
// In a page: drawJobs alone.

// Calls use(array) with image, alpha and depth of each job, and its image joined of two halves.
function drawJobs(core, jobs, numbers, use) {
  const times = [];
  let at = 0;
  for (const job of jobs) {
    const parts = [3, 4, 3, 1, 3 * job.coefficients].map((each) => numbers.subarray(at, (at += each * job.size)));
    core.setScene(job.size, job.coefficients, parts);
    const camera = core.makeCamera(job.camera);
    const whole = core.render(camera, { ...job.camera, ...job, depth: true });
    [whole.image, whole.alpha, whole.depth].forEach(use);
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
    use(joined);
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
  return times;
}

if (typeof require === "function") {
  const fs = require("fs"), path = require("path"), zlib = require("zlib");
  const [folder, coreFolder] = process.argv.slice(2);
  const { Core } = require(path.join(coreFolder, "core.js"));
  (async () => {
    const core = await Core.load(zlib.gunzipSync(fs.readFileSync(path.join(coreFolder, "core.wasm.gz"))));
    const jobs = JSON.parse(fs.readFileSync(path.join(folder, "jobs.json")));
    const file = fs.readFileSync(path.join(folder, "numbers.bin"));
    const numbers = new Float32Array(file.buffer, file.byteOffset, file.byteLength / 4);
    const out = fs.openSync(path.join(folder, "images.bin"), "w");
    const times = drawJobs(core, jobs, numbers, (array) => fs.writeSync(out, new Uint8Array(array.buffer)));
    fs.closeSync(out);
    fs.writeFileSync(path.join(folder, "times.json"), JSON.stringify(times));
  })().catch((error) => { console.error(error.message); process.exit(1); });
}
