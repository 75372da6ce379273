// Shows a scene before there are Gaussians: what is being done, the pictures, cameras and points.
const $ = (id) => document.getElementById(id);
// Milliseconds between two requests: what is shown changes about as often.
const PAUSE_MS = 700;
// Distance of the eye from the middle, x the radius that holds most points and all cameras.
const FAR = 2.4;
// Share of the points that lie within the radius: the farthest ones are few and uncertain.
const WITHIN = 0.8;
// Length of a camera's drawn edges, x the radius.
const EDGE = 0.06;
// Angles of the eye at first, radians: around the vertical, and above the horizon.
const FIRST_LOOK = [0.6, 0.5];
// Highest and lowest angle above the horizon: the picture never turns over.
const STEEPEST = 1.5;

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const n = Math.hypot(...a) || 1; return [a[0] / n, a[1] / n, a[2] / n]; };
const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
const middle = (values, share) => values.sort()[Math.min(values.length - 1, Math.floor(share * values.length))];

let found = null; // cameras and points, and from where they are looked at
let look = [...FIRST_LOOK];

function take(row) { // places what was found about its middle
  const points = new Float32Array(bytes(row.points).buffer), colors = bytes(row.colors), count = points.length / 3;
  const centers = row.cameras.map((pose) => [pose[3], pose[7], pose[11]]);
  const center = [0, 1, 2].map((k) => middle(Float32Array.from({ length: count }, (_, i) => points[3 * i + k]), 0.5));
  const away = (p) => Math.hypot(p[0] - center[0], p[1] - center[1], p[2] - center[2]);
  const reach = middle(Float32Array.from({ length: count }, (_, i) => away(points.subarray(3 * i, 3 * i + 3))), WITHIN);
  const up = unit(row.cameras.reduce((sum, pose) => [sum[0] - pose[1], sum[1] - pose[5], sum[2] - pose[9]], [0, 0, 0]));
  const east = unit(cross(up, Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 0, 1]));
  found = { points, colors, count, cameras: row.cameras, center, up, east, north: cross(east, up), radius: Math.max(reach, ...centers.map(away)) || 1 };
}

function draw() {
  const canvas = $("canvas"), area = $("stage").getBoundingClientRect();
  Object.assign($("picture").style, { width: `${area.width}px`, height: `${area.height}px` });
  [canvas.width, canvas.height] = [area.width, area.height].map((side) => Math.max(1, Math.round(side * devicePixelRatio)));
  if (!found) return;
  const { width, height } = canvas, { center, up, east, north, radius } = found;
  const flat = [0, 1, 2].map((k) => Math.cos(look[0]) * north[k] + Math.sin(look[0]) * east[k]);
  const back = [0, 1, 2].map((k) => Math.cos(look[1]) * flat[k] + Math.sin(look[1]) * up[k]);
  const right = unit(cross(up, back)), top = cross(back, right), focal = 0.5 * FAR * Math.min(width, height);
  const place = (p) => {
    const q = [p[0] - center[0], p[1] - center[1], p[2] - center[2]], depth = FAR * radius - dot(q, back);
    return depth > 0.05 * radius ? [width / 2 + focal * dot(q, right) / depth, height / 2 - focal * dot(q, top) / depth] : null;
  };
  const brush = canvas.getContext("2d"), image = brush.createImageData(width, height), side = Math.max(1, Math.round(1.5 * devicePixelRatio));
  for (let i = 0; i < found.count; i++) {
    const at = place(found.points.subarray(3 * i, 3 * i + 3));
    if (!at) continue;
    const [x, y] = at.map(Math.round);
    for (let row = Math.max(0, y); row < Math.min(height, y + side); row++) {
      for (let column = Math.max(0, x); column < Math.min(width, x + side); column++) image.data.set([found.colors[3 * i], found.colors[3 * i + 1], found.colors[3 * i + 2], 255], 4 * (row * width + column));
    }
  }
  brush.putImageData(image, 0, 0);
  brush.strokeStyle = "#fb923c";
  brush.lineWidth = devicePixelRatio;
  brush.beginPath();
  for (const pose of found.cameras) { // its centre, and the corners of its picture
    const corner = (x, y) => place([0, 1, 2].map((k) => pose[4 * k + 3] + EDGE * radius * (0.6 * x * pose[4 * k] + 0.45 * y * pose[4 * k + 1] + pose[4 * k + 2])));
    const tip = place([pose[3], pose[7], pose[11]]), corners = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
    if (!tip || corners.includes(null)) continue;
    for (let k = 0; k < 4; k++) { brush.moveTo(...tip); brush.lineTo(...corners[k]); brush.lineTo(...corners[(k + 1) % 4]); }
  }
  brush.stroke();
}

function showPictures(names, base) {
  if ($("strip").children.length === names.length || !names.length) return;
  $("strip").hidden = false;
  $("strip").replaceChildren(...names.map((name) => Object.assign(document.createElement("img"), { src: `${base}picture?${encodeURIComponent(JSON.stringify({ name }))}`, loading: "lazy", alt: "", height: 68, title: name })));
}

function lasts(seconds) {
  const whole = Math.ceil(seconds);
  return whole >= 60 ? `${Math.floor(whole / 60)} min ${whole % 60} s` : `${whole} s`;
}

function showState(now) {
  const text = [now.stage, now.text].filter(Boolean).join(": ");
  $("making").hidden = false;
  $("making-bar").value = now.share;
  $("making-text").textContent = text || "Starting …";
  $("doing").hidden = now.stage === "training"; // the panel's own section says more
  $("doing").textContent = text;
  $("making-left").textContent = now.seconds_left > 0 ? `about ${lasts(now.seconds_left)} left` : "";
  document.body.dataset.making = now.stage;
}

// Shows what is being done until there are Gaussians, and from then on beside them; the page loads
// again whenever there is another scene to be seen. Resolves to the first that there is.
export async function watchMaking(scene, ask, base) {
  const first = scene.shown;
  let version = 0;
  const step = async () => {
    const now = await ask("making", { version });
    showState(now);
    version = now.version;
    if (first === 0) {
      showPictures(now.pictures, base);
      if (now.found) {
        take(now.found);
        $("making-found").textContent = `${now.found.cameras.length} of ${now.found.images} pictures have a pose · ${now.found.num_points.toLocaleString()} points`;
        draw();
        document.body.dataset.cameras = now.found.cameras.length;
      }
    }
    return now;
  };
  const rest = () => new Promise((done) => setTimeout(done, PAUSE_MS));
  if (first > 0) {
    (async () => {
      for (;;) {
        await rest();
        const now = await step();
        if (now.shown !== first) return location.reload();
        if (now.stage === "finished") return ($("making").hidden = $("doing").hidden = true);
      }
    })().catch(() => {}); // the page says it when it asks for the next frame
    return scene;
  }
  document.body.classList.add("making");
  $("name").textContent = document.title = scene.name;
  const turn = (event) => {
    if (!event.buttons) return;
    look = [look[0] - event.movementX / 200, Math.max(-STEEPEST, Math.min(STEEPEST, look[1] + event.movementY / 200))];
    draw();
  };
  $("canvas").addEventListener("pointermove", turn);
  const resized = new ResizeObserver(draw);
  resized.observe($("stage"));
  while ((await step()).shown === 0) await rest();
  location.reload();
  return new Promise(() => {}); // until the page has loaded again
}
