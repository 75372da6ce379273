// Reads lens files as the pages do: argv: folder of the core, then files; prints a JSON row for each.
const fs = require("fs");
const path = require("path");
const zlib = require("zlib");

const [folder, ...files] = process.argv.slice(2);
const { Core } = require(path.join(folder, "core.js"));
const { LensFile } = require(path.join(folder, "lens_files.js"));

(async () => {
  const core = await Core.load(zlib.gunzipSync(fs.readFileSync(path.join(folder, "core.wasm.gz"))));
  const rows = files.map((file) => {
    try { return { lenses: LensFile.read(core, path.basename(file), fs.readFileSync(file, "utf8")) }; } catch (error) { return { error: error.message }; }
  });
  console.log(JSON.stringify(rows));
})();
