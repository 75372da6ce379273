// Unpacks the texts of this page and runs its scripts.
"use strict";
const part = (id) => document.getElementById(id);

async function unpack(id) { // compressed bytes in a script element
  if (typeof WebAssembly !== "object" || typeof DecompressionStream !== "function") {
    throw new Error("this browser is too old for this page; open it in Chrome 95, Firefox 113, Safari 16.4 or later");
  }
  try {
    const letters = atob(part(id).textContent), packed = new Uint8Array(letters.length);
    for (let i = 0; i < letters.length; i++) packed[i] = letters.charCodeAt(i);
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
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
