// The forward pass on a graphics card: records, tile lists, order, blend. Lenses are data: the rays of the
// pixels and the cones of the tiles, so that there is no lens in this text. A page at rest is
// within one grey level of gsut.render (tests/python/view/test_exact_page.py).
//
// A record is five vec4: (a, k), (b, kappa), (c, log2 opacity), (red, green, blue, distance), (u, 0), with
// a, b, c, k, kappa as in cpp/gsut/raster/frame.h and u the unit direction of the mean. Along a ray d,
// p = a.(d - u), q = b.(d - u), z = 1 + c.(d - u): a and b are orthogonal to u and c.u = 1, so that nothing
// is lost in a difference of large products.

struct View {
  center: vec4f,      // of the camera, rounded to float; w: log2 of the least alpha
  center_low: vec4f,  // what rounding took; w: largest cut-off of D^2
  row0: vec4f,        // rotation camera_from_world; w: largest alpha
  row1: vec4f,        // w: least transmittance
  row2: vec4f,        // w: 1 to order by z, else by distance
  range: vec4f,       // near z, far z; z: 1 to stop before the Gaussian that would cross
  size: vec4u,        // Gaussians, tiles across, tiles down, degree of harmonics
  cells: vec4u,       // cells across, cells down, harmonics stored a Gaussian, first Gaussian of this part
};
struct Sort { count: u32, shift: u32, blocks: u32, unused: u32 };

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> splats: array<f32>;    // (N, 11) mean, quat, log scale, logit
@group(0) @binding(2) var<storage, read> harmonics: array<f32>; // (N, K, 3)
@group(0) @binding(3) var<storage, read> cones: array<vec4f>;   // cells, then tiles: direction, radius; < 0: no ray
@group(0) @binding(4) var<storage, read_write> records: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> depth_keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> depth_values: array<u32>;
@group(0) @binding(7) var<storage, read_write> tile_counts: array<u32>;

const CELL = 4u;
const LARGEST_EXPONENT = 88.5;
const INSIDE_SCALE = 5.8207661e-11;  // 2^-34
const HALF_LOG2_E = 0.72134752;
const TWO_LN2 = 1.38629436;
const RADIUS_SLACK = 2e-6;
const FORM_SLACK = 1e-5;

fn is_finite(x: f32) -> bool { return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u; }
fn sortable(x: f32) -> u32 {
  let bits = bitcast<u32>(x + 0.0);
  return select(bits | 0x80000000u, ~bits, (bits & 0x80000000u) != 0u);
}
fn rotate(v: vec3f) -> vec3f { return vec3f(dot(view.row0.xyz, v), dot(view.row1.xyz, v), dot(view.row2.xyz, v)); }

fn harmonic(at: u32, k: u32) -> vec3f {
  let i = at + 3u * k;
  return vec3f(harmonics[i], harmonics[i + 1u], harmonics[i + 2u]);
}
fn color_of(i: u32, n: vec3f) -> vec3f {
  let at = 3u * view.cells.z * i;
  var c = vec3f(0.5) + 0.28209479177387814 * harmonic(at, 0u);
  if (view.size.w > 0u) {
    c += 0.4886025119029199 * (-n.y * harmonic(at, 1u) + n.z * harmonic(at, 2u) - n.x * harmonic(at, 3u));
  }
  if (view.size.w > 1u) {
    let xx = n.x * n.x; let yy = n.y * n.y; let zz = n.z * n.z;
    c += 1.0925484305920792 * (n.x * n.y * harmonic(at, 4u) - n.y * n.z * harmonic(at, 5u) - n.x * n.z * harmonic(at, 7u))
      + 0.31539156525252005 * (2.0 * zz - xx - yy) * harmonic(at, 6u) + 0.5462742152960396 * (xx - yy) * harmonic(at, 8u);
    if (view.size.w > 2u) {
      c += -0.5900435899266435 * n.y * (3.0 * xx - yy) * harmonic(at, 9u) + 2.890611442640554 * n.x * n.y * n.z * harmonic(at, 10u)
        - 0.4570457994644658 * n.y * (4.0 * zz - xx - yy) * harmonic(at, 11u) + 0.3731763325901154 * n.z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * harmonic(at, 12u)
        - 0.4570457994644658 * n.x * (4.0 * zz - xx - yy) * harmonic(at, 13u) + 1.445305721320277 * n.z * (xx - yy) * harmonic(at, 14u)
        - 0.5900435899266435 * n.x * (xx - 3.0 * yy) * harmonic(at, 15u);
    }
  }
  return max(c, vec3f(0.0));
}

struct Record { a: vec4f, b: vec4f, c: vec4f, color: vec4f, u: vec4f, key: f32, seen: bool };

fn make_record(i: u32) -> Record {
  var out: Record;
  out.seen = false;
  let at = 11u * i;
  let world = (vec3f(splats[at], splats[at + 1u], splats[at + 2u]) - view.center.xyz) - view.center_low.xyz;
  var q = vec4f(splats[at + 3u], splats[at + 4u], splats[at + 5u], splats[at + 6u]);
  let logs = vec3f(splats[at + 7u], splats[at + 8u], splats[at + 9u]);
  let logit = splats[at + 10u];
  if (!(is_finite(logit) && is_finite(q.x) && is_finite(q.y) && is_finite(q.z) && is_finite(q.w))) { return out; }
  if (!(max(logs.x, max(logs.y, logs.z)) <= LARGEST_EXPONENT)) { return out; }
  let largest = max(max(abs(q.x), abs(q.y)), max(abs(q.z), abs(q.w)));
  if (largest > 0.0) { q = q / largest; } else { q = vec4f(1.0, 0.0, 0.0, 0.0); }
  q = q / sqrt(dot(q, q));
  let log2_opacity = -log2(1.0 + exp(min(-logit, LARGEST_EXPONENT)));
  let cutoff = min(TWO_LN2 * (log2_opacity - view.center.w), view.center_low.w);
  let g = sqrt(dot(world, world));
  if (!(cutoff > 0.0) || !(g > 0.0)) { return out; }
  let mean = rotate(world);
  if (!(mean.z >= view.range.x && mean.z <= view.range.y)) { return out; }
  let w = q.x; let x = q.y; let y = q.z; let z = q.w;
  let q0 = rotate(vec3f(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)));
  let q1 = rotate(vec3f(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)));
  let q2 = rotate(vec3f(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)));
  let inverse = vec3f(1.0) / exp(logs);
  let white = vec3f(dot(q0, mean), dot(q1, mean), dot(q2, mean)) * inverse;
  let g2 = dot(white, white);
  let u = mean / g;
  let sign = select(-1.0, 1.0, u.z >= 0.0);
  let aa = -1.0 / (sign + u.z);
  let bb = u.x * u.y * aa;
  let e1 = vec3f(1.0 + sign * u.x * u.x * aa, sign * bb, -sign * u.x);
  let e2 = vec3f(bb, sign + u.y * u.y * aa, -u.y);
  let factor = g * g / sqrt(g2);
  let weight = factor * vec3f(inverse.y * inverse.z, inverse.x * inverse.z, inverse.x * inverse.y);
  let k1 = weight * vec3f(dot(q0, e2), dot(q1, e2), dot(q2, e2));
  let k2 = -weight * vec3f(dot(q0, e1), dot(q1, e1), dot(q2, e1));
  let n11 = dot(k1, k1); let n22 = dot(k2, k2); let twice = 2.0 * dot(k1, k2);
  let zeta = (n22 - n11) / select(1e-30, twice, abs(twice) > 0.0);
  let tangent = select(-1.0, 1.0, zeta >= 0.0) / (abs(zeta) + sqrt(zeta * zeta + 1.0));
  let cosine = 1.0 / sqrt(tangent * tangent + 1.0);
  let sine = cosine * tangent;
  let p1 = cosine * k1 - sine * k2;
  let p2 = sine * k1 + cosine * k2;
  let n1 = sqrt(dot(p1, p1)); let n2 = sqrt(dot(p2, p2));
  let product = g * g * g / sqrt(g2) * inverse.x * inverse.y * inverse.z;
  let first_is_large = n1 >= n2;
  let sigma1 = select(product / n2, n1, first_is_large);
  let sigma2 = select(n2, product / n1, first_is_large);
  let s = max(1.0 / cutoff - 1.0 / g2, INSIDE_SCALE / g2);
  let root = sqrt(s);
  out.a = vec4f(root * sigma1 * (cosine * e1 - sine * e2), 1.0 / (g2 * s));
  out.b = vec4f(root * sigma2 * (sine * e1 + cosine * e2), -HALF_LOG2_E / s);
  out.c = vec4f(g / g2 * (q0 * (white.x * inverse.x) + q1 * (white.y * inverse.y) + q2 * (white.z * inverse.z)), log2_opacity);
  out.color = vec4f(color_of(i, world / g), g);
  out.u = vec4f(u, 0.0);
  out.key = select(g, mean.z, view.row2.w > 0.5);
  let sum = dot(abs(out.a), vec4f(1.0)) + dot(abs(out.b), vec4f(1.0)) + dot(abs(out.c.xyz), vec3f(1.0)) + dot(out.color.xyz, vec3f(1.0));
  out.seen = is_finite(sum);
  return out;
}

// Whether a cone of rays may hold one that hits: |p| is at least |p of the cone's axis| - |a| radius.
fn may_hit(r0: vec4f, r1: vec4f, r2: vec4f, u: vec3f, cone: vec4f) -> bool {
  if (cone.w < 0.0) { return false; }
  let e = cone.xyz - u;
  let radius = cone.w + RADIUS_SLACK;
  let p = max(abs(dot(r0.xyz, e)) - length(r0.xyz) * radius, 0.0);
  let q = max(abs(dot(r1.xyz, e)) - length(r1.xyz) * radius, 0.0);
  let z = 1.0 + dot(r2.xyz, e) + length(r2.xyz) * radius;
  return z > 0.0 && p * p + q * q <= z * z * (1.0 + FORM_SLACK);
}

@compute @workgroup_size(256)
fn make_records(@builtin(global_invocation_id) id: vec3u) {
  let i = id.x;
  if (i >= view.size.x) { return; }
  let r = make_record(i);
  depth_values[i] = view.cells.w + i;
  var count = 0u;
  if (r.seen) {
    records[5u * i] = r.a; records[5u * i + 1u] = r.b; records[5u * i + 2u] = r.c;
    records[5u * i + 3u] = r.color; records[5u * i + 4u] = r.u;
    let cells = view.cells.x * view.cells.y;
    for (var cell = 0u; cell < cells; cell++) {
      if (!may_hit(r.a, r.b, r.c, r.u.xyz, cones[cell])) { continue; }
      let x0 = cell % view.cells.x * CELL; let y0 = cell / view.cells.x * CELL;
      for (var y = y0; y < min(y0 + CELL, view.size.z); y++) {
        for (var x = x0; x < min(x0 + CELL, view.size.y); x++) {
          if (may_hit(r.a, r.b, r.c, r.u.xyz, cones[cells + y * view.size.y + x])) { count++; }
        }
      }
    }
  }
  tile_counts[i] = count;
  depth_keys[i] = select(0xffffffffu, sortable(r.key), count > 0u);
}

// --- stable radix sort: four bits a pass, no subgroups -----------------------------------------------
@group(1) @binding(0) var<uniform> sort: Sort;
@group(1) @binding(1) var<storage, read> keys_in: array<u32>;
@group(1) @binding(2) var<storage, read> values_in: array<u32>;
@group(1) @binding(3) var<storage, read_write> keys_out: array<u32>;
@group(1) @binding(4) var<storage, read_write> values_out: array<u32>;
@group(1) @binding(5) var<storage, read_write> digit_counts: array<u32>;  // (16, blocks)

var<workgroup> masks: array<atomic<u32>, 128>;  // (16 digits, 8 words): which items have the digit

fn mark_digits(local: u32, i: u32) -> u32 {
  if (local < 128u) { atomicStore(&masks[local], 0u); }
  workgroupBarrier();
  var digit = 16u;
  if (i < sort.count) {
    digit = (keys_in[i] >> sort.shift) & 15u;
    atomicOr(&masks[8u * digit + local / 32u], 1u << (local % 32u));
  }
  workgroupBarrier();
  return digit;
}
@compute @workgroup_size(256)
fn count_digits(@builtin(workgroup_id) block: vec3u, @builtin(local_invocation_index) local: u32) {
  mark_digits(local, 256u * block.x + local);
  if (local < 16u) {
    var sum = 0u;
    for (var word = 0u; word < 8u; word++) { sum += countOneBits(atomicLoad(&masks[8u * local + word])); }
    digit_counts[local * sort.blocks + block.x] = sum;
  }
}
@compute @workgroup_size(256)
fn scatter(@builtin(workgroup_id) block: vec3u, @builtin(local_invocation_index) local: u32) {
  let i = 256u * block.x + local;
  let digit = mark_digits(local, i);
  if (i >= sort.count) { return; }
  var place = digit_counts[digit * sort.blocks + block.x];
  for (var word = 0u; word < local / 32u; word++) { place += countOneBits(atomicLoad(&masks[8u * digit + word])); }
  place += countOneBits(atomicLoad(&masks[8u * digit + local / 32u]) & ((1u << (local % 32u)) - 1u));
  keys_out[place] = keys_in[i];
  values_out[place] = values_in[i];
}

// --- sums before each entry, in place; one workgroup, a stretch of 16 a thread ------------------------
@group(2) @binding(0) var<uniform> scan_count: vec4u;
@group(2) @binding(1) var<storage, read_write> sums: array<u32>;  // one more entry: the whole sum
const STRETCH = 16u;
var<workgroup> partial: array<u32, 256>;

@compute @workgroup_size(256)
fn scan(@builtin(local_invocation_index) local: u32) {
  var carry = 0u;
  for (var base = 0u; base < scan_count.x; base += 256u * STRETCH) {
    let first = base + local * STRETCH;
    let last = min(first + STRETCH, scan_count.x);
    var own = 0u;
    for (var i = first; i < last; i++) { own += sums[i]; }
    partial[local] = own;
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
      var left = 0u;
      if (local >= step) { left = partial[local - step]; }
      workgroupBarrier();
      partial[local] += left;
      workgroupBarrier();
    }
    var before = carry + partial[local] - own;
    for (var i = first; i < last; i++) { let here = sums[i]; sums[i] = before; before += here; }
    carry += partial[255];
    workgroupBarrier();
  }
  if (local == 0u) { sums[scan_count.x] = carry; }
}

// --- pairs ------------------------------------------------------------------------------------------
@group(1) @binding(6) var<storage, read> order: array<u32>;              // Gaussians, nearest first
@group(1) @binding(7) var<storage, read_write> pair_begin: array<u32>;   // (N + 1), in this order

@compute @workgroup_size(256)
fn order_counts(@builtin(global_invocation_id) id: vec3u) {
  if (id.x < view.size.x) { pair_begin[id.x] = tile_counts[order[id.x]]; }
}
@compute @workgroup_size(256)
fn list_pairs(@builtin(global_invocation_id) id: vec3u) {
  if (id.x >= view.size.x || pair_begin[id.x] == pair_begin[id.x + 1u]) { return; }
  let i = order[id.x];
  let a = records[5u * i]; let b = records[5u * i + 1u]; let c = records[5u * i + 2u]; let u = records[5u * i + 4u].xyz;
  var at = pair_begin[id.x];
  let cells = view.cells.x * view.cells.y;
  for (var cell = 0u; cell < cells; cell++) {
    if (!may_hit(a, b, c, u, cones[cell])) { continue; }
    let x0 = cell % view.cells.x * CELL; let y0 = cell / view.cells.x * CELL;
    for (var y = y0; y < min(y0 + CELL, view.size.z); y++) {
      for (var x = x0; x < min(x0 + CELL, view.size.y); x++) {
        let tile = y * view.size.y + x;
        if (!may_hit(a, b, c, u, cones[cells + tile])) { continue; }
        if (at < pair_begin[id.x + 1u]) { keys_out[at] = tile; values_out[at] = i; }
        at++;
      }
    }
  }
}

@group(1) @binding(8) var<storage, read_write> tile_begin: array<u32>;  // (tiles + 1) in the sorted pairs

@compute @workgroup_size(256)
fn find_tiles(@builtin(global_invocation_id) id: vec3u) {
  let k = id.x;
  if (k >= sort.count) { return; }
  let tiles = view.size.y * view.size.z;
  let first = select(0u, keys_in[max(k, 1u) - 1u] + 1u, k > 0u);
  for (var tile = first; tile <= keys_in[k]; tile++) { tile_begin[tile] = k; }
  if (k + 1u == sort.count) { for (var tile = keys_in[k] + 1u; tile <= tiles; tile++) { tile_begin[tile] = sort.count; } }
}

// --- blend: a workgroup a tile, a thread a pixel ------------------------------------------------------
@group(3) @binding(0) var<storage, read> rays: array<vec4f>;   // (tiles, 256): ray less the tile's direction; w: 1 if there is one
@group(3) @binding(1) var<storage, read> pairs: array<u32>;    // Gaussians by tile, nearest first
@group(3) @binding(2) var<storage, read_write> pixels: array<vec4f>;     // (tiles, 256): colour, transmittance
@group(3) @binding(3) var<storage, read_write> distances: array<vec4f>;  // (tiles, 256): sum of weight x distance, first
                                                                         // distance, sum of weight x (distance - first)^2

const BATCH = 64u;
var<workgroup> batch: array<vec4f, 320>;  // (64, 5)
var<workgroup> open_pixels: atomic<u32>;
var<workgroup> pairs_of_tile: vec2u;  // first and end: the same for all threads, which browsers want to know

@compute @workgroup_size(256)
fn blend(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
  let tile = group.x;
  let center = cones[view.cells.x * view.cells.y + tile].xyz;
  let ray = rays[256u * tile + local];
  if (local == 0u) { pairs_of_tile = vec2u(tile_begin[tile], tile_begin[tile + 1u]); }
  let range_of_tile = workgroupUniformLoad(&pairs_of_tile);
  let end = range_of_tile.y;
  let stop = view.row1.w;
  let stop_before = view.range.z > 0.5;
  var color = vec3f(0.0);
  var t = ray.w;
  var open = ray.w > 0.0;
  var along = vec4f(0.0);
  for (var begin = range_of_tile.x; begin < end; begin += BATCH) {
    workgroupBarrier();
    if (local == 0u) { atomicStore(&open_pixels, 0u); }
    let count = min(BATCH, end - begin);
    for (var k = local; k < 5u * count; k += 256u) { batch[k] = records[5u * pairs[begin + k / 5u] + k % 5u]; }
    workgroupBarrier();
    if (open) { atomicAdd(&open_pixels, 1u); }
    workgroupBarrier();
    if (workgroupUniformLoad(&open_pixels) == 0u) { break; }
    for (var k = 0u; k < count && open; k++) {
      let a = batch[5u * k]; let b = batch[5u * k + 1u]; let c = batch[5u * k + 2u];
      let e = (center - batch[5u * k + 4u].xyz) + ray.xyz;
      let p = dot(a.xyz, e); let q = dot(b.xyz, e); let z = 1.0 + dot(c.xyz, e);
      let n = p * p + q * q;
      if (!(z > 0.0 && n < z * z)) { continue; }
      let scale = 1.0 / (z * z + a.w * n);
      let alpha = min(view.row0.w, exp2(c.w + b.w * n * scale));
      let weight = alpha * t;
      if (stop_before && t - weight <= stop) { open = false; continue; }
      color += weight * batch[5u * k + 3u].xyz;
      let distance = batch[5u * k + 3u].w * z * scale;
      if (along.y == 0.0) { along.y = distance; }
      along.x += weight * distance;
      along.z += weight * (distance - along.y) * (distance - along.y);
      t -= weight;
      open = t >= stop;
    }
  }
  pixels[256u * tile + local] = vec4f(color, t);
  distances[256u * tile + local] = along;
}
