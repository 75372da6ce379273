// Unpacks the texts of this page and runs its scripts.
"use strict";
// Digits of Python's b85encode, with a comma where it has what would begin an element.
const DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;,=>?@^_`{|}~";
const part = (id) => document.getElementById(id);

function decode(text) { // base 85
  const values = new Uint8Array(128), whole = text.padEnd(5 * Math.ceil(text.length / 5), "~"), out = new DataView(new ArrayBuffer(whole.length / 5 * 4));
  [...DIGITS].forEach((digit, value) => (values[digit.charCodeAt(0)] = value));
  for (let i = 0; i < whole.length; i += 5) {
    let word = 0;
    for (let k = 0; k < 5; k++) word = 85 * word + values[whole.charCodeAt(i + k)];
    out.setUint32(4 * i / 5, word);
  }
  return new Uint8Array(out.buffer, 0, out.byteLength - (whole.length - text.length));
}
async function unpack(id) { // compressed bytes in a script element
  if (typeof WebAssembly !== "object" || typeof DecompressionStream !== "function") {
    throw new Error("this browser is too old for this page; open it in Chrome 95, Firefox 113, Safari 16.4 or later");
  }
  try {
    const stream = new Blob([decode(part(id).textContent.trim())]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  } catch {
    throw new Error(`this file is damaged: its part "${id}" cannot be read; copy it again`);
  }
}

let texts; // by name, of which "scripts" names those that run, in this order
unpack("texts").then((bytes) => {
  texts = JSON.parse(new TextDecoder().decode(bytes));
  for (const name of texts.scripts) document.body.append(Object.assign(document.createElement("script"), { textContent: texts[name] }));
}).catch((error) => { // nothing here works then: the reason stays
  document.body.classList.add("narrow");
  Object.assign(part("toast"), { textContent: error.message, hidden: false });
});
