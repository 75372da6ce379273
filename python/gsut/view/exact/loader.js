// Unpacks the texts of this page and runs its scripts.
"use strict";
const part = (id) => document.getElementById(id);

function decode(text) { // two of 91 digits for 13 bits, as page_file.py writes them
  const out = new Uint8Array(Math.floor((text.length - 1) / 2 * 13 / 8) - Number(text[0])), values = new Uint8Array(128);
  for (let code = 33, value = 0; code < 127; code++) if (!'"<\\'.includes(String.fromCharCode(code))) values[code] = value++;
  for (let i = 1, at = 0, word = 0, bits = 0; i < text.length; i += 2) {
    word = (word << 13) | (91 * values[text.charCodeAt(i)] + values[text.charCodeAt(i + 1)]);
    for (bits += 13; bits >= 8; bits -= 8) out[at++] = word >> (bits - 8);
    word &= (1 << bits) - 1;
  }
  return out;
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
