// Selects Gaussians by box, lasso and brush, and deletes or keeps them. The edits are a list that the server
// applies: undo takes the last away, and the same list is the file that gsut edit --apply repeats.
"use strict";

const TOOLS = { move: "Move", box: "Box", lasso: "Lasso", brush: "Brush" };
// CSS pixels between points of a stroke.
const STROKE_STEP = 3;
const edits = { on: false, tool: "box", steps: [], undone: [], key: null, selected: 0, kept: null, of: 0 };
let stroke = null; // { event, frame, points on the picture in CSS pixels, subtract }

// --- strokes ---
const onPicture = (event) => {
  const box = $("canvas").getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
};
function beginStroke(event) { // whether the pointer draws
  if (stroke) { // a second finger: both move the eye
    pointers.set(stroke.event.pointerId, stroke.event);
    endStroke();
  }
  if (!edits.on || edits.tool === "move" || event.button !== 0 || pointers.size) return false;
  const { pose, lens, turns, width, height } = request(false);
  stroke = { event, frame: { pose, lens, turns, width, height }, points: [onPicture(event)], subtract: $("how").querySelector("[value=subtract]").checked !== event.shiftKey };
  $("canvas").setPointerCapture(event.pointerId);
  showStroke();
  return true;
}
function continueStroke(event) {
  if (event.pointerId !== stroke?.event.pointerId) return false;
  const { points } = stroke, at = onPicture(event);
  if (edits.tool === "box") points[1] = at;
  else if (Math.hypot(at[0] - points.at(-1)[0], at[1] - points.at(-1)[1]) >= STROKE_STEP) points.push(at);
  showStroke();
  return true;
}
function finishStroke(event) {
  if (event.pointerId !== stroke?.event.pointerId) return false;
  const { frame, subtract } = stroke, points = outline(), scale = frame.width / $("canvas").getBoundingClientRect().width;
  endStroke();
  const brush = edits.tool === "brush", region = points.map((at) => at.map((value) => value * scale));
  if (event.type === "pointerup" && (brush || points.length > 2)) {
    edit({ do: "select", frame, points: region, ...(brush ? { radius: $("brush").value / 2 * scale } : {}), ...(subtract ? { subtract } : {}), ...($("front").checked ? { front: true } : {}) });
  }
  return true;
}
function endStroke() {
  stroke = null;
  $("stroke-path").removeAttribute("d");
}
function outline() {
  const [a, b] = stroke.points;
  if (edits.tool !== "box") return stroke.points;
  return b ? [a, [b[0], a[1]], b, [a[0], b[1]]] : [a];
}
function showStroke() {
  const path = $("stroke-path"), brush = edits.tool === "brush", points = outline();
  path.setAttribute("d", `M${[...points, points.at(-1)].join("L")}${brush ? "" : "Z"}`);
  path.classList.toggle("brush", brush);
  path.style.strokeWidth = brush ? $("brush").value : "";
}

// --- edits ---
let editing = Promise.resolve(); // edits are applied in turn
async function setEdits(change) { // change: of the steps and of those that were undone
  editing = editing.catch(() => {}).then(async () => {
    const before = [[...edits.steps], [...edits.undone]];
    change();
    try {
      Object.assign(edits, await ask("edits", { steps: edits.steps }));
    } catch (error) {
      [edits.steps, edits.undone] = before;
      throw error;
    }
    showEdits();
    redraw(false);
  });
  await guarded(() => editing)();
}
const edit = (step) => setEdits(() => { edits.steps.push(step); edits.undone = []; });
const undo = () => setEdits(() => edits.steps.length && edits.undone.push(edits.steps.pop()));
const redo = () => setEdits(() => edits.undone.length && edits.steps.push(edits.undone.pop()));
function showEdits() {
  const { selected, kept, of, steps, undone } = edits, count = (n) => n.toLocaleString();
  $("selected").textContent = kept === null ? "Drag over what you want to select." : `${count(selected)} of ${count(kept)} selected${kept < of ? `, ${count(of - kept)} deleted` : ""}`;
  for (const id of ["edit-delete", "edit-keep", "edit-clear"]) $(id).disabled = !selected;
  $("undo").disabled = !steps.length;
  $("redo").disabled = !undone.length;
  $("edit-file").disabled = !steps.length;
}
function setSelecting(on) {
  if (!scene.selectable || edits.on === on) return;
  endStroke();
  if (!on && edits.selected) edit({ do: "clear" });
  edits.on = on;
  $("selecting").hidden = !on;
  $("select").setAttribute("aria-pressed", String(on));
  takeTool(edits.tool);
  showEdits();
}
function takeTool(tool) {
  edits.tool = tool;
  $("brush-row").hidden = tool !== "brush";
  $("canvas").classList.toggle("selecting", edits.on && tool !== "move");
}
async function saveEdits() {
  save(await server.file("edits.json", { steps: edits.steps }), `${fileName()}.edits.json`);
  toast(`To make the edits, run: gsut edit RUN --apply ${fileName()}.edits.json -o edited.ply`, 12);
}

// --- keys and buttons ---
const SELECT_KEYS = { KeyB: "box", KeyF: "lasso", KeyG: "brush", KeyN: "move" };
function onSelectKey(event) { // whether it was one of selecting
  const command = event.ctrlKey || event.metaKey;
  if (command && /^Key[ZY]$/.test(event.code) && edits.on) {
    event.preventDefault();
    event.code === "KeyY" || event.shiftKey ? redo() : undo();
  } else if (command || event.altKey) return false;
  else if (event.code === "KeyV") setSelecting(!edits.on);
  else if (!edits.on) return false;
  else if (event.code === "Escape") stroke ? endStroke() : setSelecting(false);
  else if (event.code in SELECT_KEYS) choose("tools", SELECT_KEYS[event.code]);
  else if (/^(Delete|Backspace)$/.test(event.code)) $("edit-delete").click();
  else return false;
  return true;
}
function connectSelecting() {
  $("select").hidden = !scene.selectable;
  choices("tools", TOOLS, edits.tool, takeTool);
  choices("how", { add: "Add", subtract: "Subtract" }, "add", () => {});
  const on = (id, action) => $(id).addEventListener("click", guarded(action));
  on("select", () => setSelecting(!edits.on));
  on("edit-done", () => setSelecting(false));
  for (const what of ["delete", "keep", "clear"]) on(`edit-${what}`, () => edit({ do: what }));
  on("undo", undo);
  on("redo", redo);
  on("edit-file", saveEdits);
}
