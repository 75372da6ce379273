// The picture of a moving eye: each Gaussian is a quad around its silhouette, and a pixel asks for its response
// along the pixel's own ray, so that only the order's and the target's precision differ from the exact picture.
// Lenses are data: rays of the pixels, and a table of where a direction falls on the image, over two charts
// s = (x, y) / (1 + |z|) of unit directions, one of those ahead and one of those behind.
// Nearest first: what is added is weighted by what is still open, and closed pixels are left out by their depth.
#ifdef QUADS
uniform highp sampler2D gaussians;  // 3 texels: mean, opacity; x, y, z, w of the rotation; standard deviations
uniform highp sampler2D lens;       // (2 NODES, NODES) pixel, whether there is one; else one in its direction
uniform highp sampler2D harmonics;  // a texel a coefficient, as SPZ stores them
uniform highp usampler2D order;     // Gaussians, nearest first
uniform int coefficients;           // of harmonics a Gaussian
uniform mat3 rotation;              // camera_from_world
uniform vec3 center;                // of the camera
uniform vec2 size;                  // of the picture
uniform vec2 scale;                 // from pixels of the lens
uniform float span;                 // of the charts: |s.x| and |s.y| at their edges
uniform float around;               // width of a panorama, else 0
uniform int copies;                 // of each quad: 2 in a panorama
flat out vec3 row0, row1, row2, mean; // whitening of directions, and the mean whitened
flat out vec4 color;
uint gaussian;

ivec2 place(int i, ivec2 shape) { return ivec2(i % shape.x, i / shape.x); }
vec4 read(int k) { return texelFetch(gaussians, place(3 * int(gaussian) + k, textureSize(gaussians, 0)), 0); }
vec3 harmonic(int k) {
  vec3 stored = texelFetch(harmonics, place(int(gaussian) * coefficients + k, textureSize(harmonics, 0)), 0).rgb;
  return k == 0 ? (stored - 0.5) / 0.15 : (255.0 * stored - 128.0) / 128.0;
}
vec3 color_of(vec3 n) {
  vec3 c = vec3(0.5) + 0.28209479177387814 * harmonic(0);
  if (coefficients > 1) c += 0.4886025119029199 * (-n.y * harmonic(1) + n.z * harmonic(2) - n.x * harmonic(3));
  if (coefficients > 4) {
    float xx = n.x * n.x, yy = n.y * n.y, zz = n.z * n.z;
    c += 1.0925484305920792 * (n.x * n.y * harmonic(4) - n.y * n.z * harmonic(5) - n.x * n.z * harmonic(7))
      + 0.31539156525252005 * (2.0 * zz - xx - yy) * harmonic(6) + 0.5462742152960396 * (xx - yy) * harmonic(8);
    if (coefficients > 9) {
      c += -0.5900435899266435 * n.y * (3.0 * xx - yy) * harmonic(9) + 2.890611442640554 * n.x * n.y * n.z * harmonic(10)
        - 0.4570457994644658 * n.y * (4.0 * zz - xx - yy) * harmonic(11) + 0.3731763325901154 * n.z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * harmonic(12)
        - 0.4570457994644658 * n.x * (4.0 * zz - xx - yy) * harmonic(13) + 1.445305721320277 * n.z * (xx - yy) * harmonic(14)
        - 0.5900435899266435 * n.x * (xx - 3.0 * yy) * harmonic(15);
    }
  }
  return max(c, vec3(0.0));
}

// Pixel of a direction, whether there is one, and the derivatives of the pixel.
struct Seen { vec2 pixel; bool valid; vec2 by_x, by_y; };
Seen look_up(vec3 m) {
  vec2 s = m.xy / (length(m) + abs(m.z)), g = clamp((s / span * 0.5 + 0.5) * float(NODES - 1), 0.0, float(NODES - 1) - 1e-3);
  ivec2 cell = ivec2(g), first = cell + ivec2(m.z < 0.0 ? NODES : 0, 0);
  vec3 p00 = texelFetch(lens, first, 0).xyz, p10 = texelFetch(lens, first + ivec2(1, 0), 0).xyz;
  vec3 p01 = texelFetch(lens, first + ivec2(0, 1), 0).xyz, p11 = texelFetch(lens, first + ivec2(1, 1), 0).xyz;
  if (around > 0.0) {
    p10.x -= around * round((p10.x - p00.x) / around);
    p01.x -= around * round((p01.x - p00.x) / around);
    p11.x -= around * round((p11.x - p00.x) / around);
  }
  vec2 f = g - vec2(cell), per_s = scale * float(NODES - 1) * 0.5 / span;
  bool inside = all(lessThanEqual(abs(s), vec2(span))) && min(min(p00.z, p10.z), min(p01.z, p11.z)) > 0.5;
  return Seen(scale * mix(mix(p00.xy, p10.xy, f.x), mix(p01.xy, p11.xy, f.x), f.y), inside,
    per_s * mix(p10.xy - p00.xy, p11.xy - p01.xy, f.y), per_s * mix(p01.xy - p00.xy, p11.xy - p10.xy, f.x));
}

void main() {
  gl_Position = vec4(2.0, 2.0, 0.0, 1.0); // beside the picture, until all is known
  int which = gl_VertexID >> 2;
  gaussian = texelFetch(order, place(which / copies, textureSize(order, 0)), 0).x;
  vec4 a = read(0), q = read(1);
  if (a.w <= LEAST) return;
  vec3 sigma = read(2).xyz, world = a.xyz - center, m = rotation * world;
  mat3 axes = rotation * mat3(
    1.0 - 2.0 * (q.y * q.y + q.z * q.z), 2.0 * (q.x * q.y + q.w * q.z), 2.0 * (q.x * q.z - q.w * q.y),
    2.0 * (q.x * q.y - q.w * q.z), 1.0 - 2.0 * (q.x * q.x + q.z * q.z), 2.0 * (q.y * q.z + q.w * q.x),
    2.0 * (q.x * q.z + q.w * q.y), 2.0 * (q.y * q.z - q.w * q.x), 1.0 - 2.0 * (q.x * q.x + q.y * q.y));
  row0 = axes[0] / sigma.x;
  row1 = axes[1] / sigma.y;
  row2 = axes[2] / sigma.z;
  mean = vec3(dot(row0, m), dot(row1, m), dot(row2, m));
  // The silhouette: directions n + e cos + f sin, where the response falls below the least alpha.
  float cut = 2.0 * log(a.w / LEAST), far = dot(mean, mean), r = length(m);
  vec2 pixel = 0.5 * size, p = vec2(0.5 * size.x, 0.0), v = vec2(0.0, 0.5 * size.y);
  if (far > cut * 1.01) { // else the eye is inside: all of the picture
    vec3 n = mean * inversesqrt(far), side = abs(n.x) < 0.6 ? vec3(1.0, 0.0, 0.0) : abs(n.y) < 0.6 ? vec3(0.0, 1.0, 0.0) : vec3(0.0, 0.0, 1.0);
    vec3 e = normalize(cross(n, side)), f = cross(n, e);
    float reach = sqrt(cut * far / (far - cut)); // of the tangent of the cone, x the distance
    e = axes * (sigma * e * reach);
    f = axes * (sigma * f * reach);
    Seen seen = look_up(m);
    float d = r + abs(m.z), whole = around * scale.x;
    vec2 s = m.xy / d;
    vec3 dd = m / r + vec3(0.0, 0.0, m.z < 0.0 ? -1.0 : 1.0);
    vec2 se = (e.xy - s * dot(dd, e)) / d, sf = (f.xy - s * dot(dd, f)) / d;
    pixel = seen.pixel;
    p = (seen.by_x * se.x + seen.by_y * se.y) * LINEAR_MARGIN;
    v = (seen.by_x * sf.x + seen.by_y * sf.y) * LINEAR_MARGIN;
    if (max(dot(e, e), dot(f, f)) <= WIDE * r * r) { // the lens is linear there
      if (!seen.valid) return;
    } else { // a box along the axes of the linear one, around corners of an octagon around the silhouette
      float angle = seen.valid ? 0.5 * atan(2.0 * (p.x * p.y + v.x * v.y), p.x * p.x + v.x * v.x - p.y * p.y - v.y * v.y) : 0.0;
      mat2 turn = mat2(cos(angle), sin(angle), -sin(angle), cos(angle));
      vec2 low = vec2(1e9), high = vec2(-1e9);
      for (int k = 0; k < 8; k++) {
        float t = 0.7853981634 * float(k);
        vec2 off = look_up(m + 1.0823922 * (e * cos(t) + f * sin(t))).pixel - seen.pixel;
        if (around > 0.0) off.x -= whole * round(off.x / whole);
        low = min(low, off * turn);
        high = max(high, off * turn);
      }
      pixel += turn * (0.5 * (low + high));
      p = turn[0] * 0.5 * (high.x - low.x);
      v = turn[1] * 0.5 * (high.y - low.y);
      if (around > 0.0 && abs(p.x) + abs(v.x) > 0.25 * whole) { // it may hold a pole
        float top = pixel.y - abs(p.y) - abs(v.y), bottom = pixel.y + abs(p.y) + abs(v.y);
        if (top < size.y - bottom) top = 0.0; else bottom = size.y;
        pixel = vec2(0.5 * whole, 0.5 * (top + bottom));
        p = vec2(0.5 * whole, 0.0);
        v = vec2(0.0, 0.5 * (bottom - top));
      }
    }
  }
  vec2 extent = abs(p) + abs(v);
  if (copies == 2) { // where a quad crosses one edge of a panorama it comes in at the other
    float whole = around * scale.x; // of the panorama
    pixel.x -= whole * floor(pixel.x / whole);
    if ((which & 1) == 1) {
      if (extent.x >= 0.5 * whole) return;
      if (pixel.x < extent.x) pixel.x += whole;
      else if (pixel.x + extent.x > whole) pixel.x -= whole;
      else return;
    }
  }
  if (any(lessThan(pixel + extent, vec2(0.0))) || any(greaterThan(pixel - extent, size))) return;
  color = vec4(color_of(world / r), a.w);
  vec2 corner = pixel + p * (float(gl_VertexID & 1) * 2.0 - 1.0) + v * (float((gl_VertexID >> 1) & 1) * 2.0 - 1.0);
  gl_Position = vec4((2.0 * corner / size - 1.0) * vec2(1.0, -1.0), 0.0, 1.0);
}
#endif
#ifdef RESPONSE
uniform highp sampler2D rays; // of the pixels, upwards as the target's; w: whether there is one
flat in vec3 row0, row1, row2, mean;
flat in vec4 color;
out vec4 added;
void main() {
  vec4 ray = texelFetch(rays, ivec2(gl_FragCoord.xy), 0);
  vec3 d = vec3(dot(row0, ray.xyz), dot(row1, ray.xyz), dot(row2, ray.xyz)), off = cross(mean, d);
  float alpha = color.a * exp(-0.5 * dot(off, off) / dot(d, d));
  alpha = alpha >= LEAST && dot(mean, d) > 0.0 ? ray.w * min(alpha, MOST) : 0.0;
  added = vec4(alpha * color.rgb, alpha);
}
#endif
#ifdef SCREEN
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, -1.0, 1.0); }
#endif
#ifdef CLOSE
uniform highp sampler2D picture;
void main() { if (texelFetch(picture, ivec2(gl_FragCoord.xy), 0).a < CLOSED) discard; }
#endif
#ifdef SHOW
uniform highp sampler2D picture, rays;
uniform vec4 background; // w: 0 for the colour of what is around
out vec4 shown;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec4 found = texelFetch(picture, at, 0), behind = background;
  vec2 where = gl_FragCoord.xy / vec2(textureSize(picture, 0));
  for (float level = 4.0; behind.a < 0.99 && level < 14.0; level += 1.0) behind += (1.0 - behind.a) * textureLod(picture, where, level);
  shown = vec4(texelFetch(rays, at, 0).w * (found.rgb + (1.0 - found.a) * behind.rgb / max(behind.a, 1e-3)), 1.0);
}
#endif
