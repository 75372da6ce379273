// Intersects rays with triangles by a tree of boxes, and shades what they hit.
#include "tracer.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>

namespace proving {
namespace {

constexpr int kLeaf = 2;               // triangles of a leaf
constexpr int kBins = 16;              // places at which a box may be cut
constexpr int kMostBounces = 3;        // reflections and panes along one ray
constexpr float kLift = 2e-4f;         // start of secondary rays above a surface, of its distance
constexpr float kLeastLift = 1e-4f;    // metres
constexpr float kLampSoftness = 0.1f;  // m^2, keeps the light finite beside a lamp
constexpr float kIndirect = 0.08f;     // light of surroundings that are themselves shaded
constexpr Vec3 kBounced{0.3f, 0.3f, 0.3f};  // light of the ground
constexpr int kDirections = 2;              // to the surroundings, of each ray of a pixel
constexpr float kFaint = 0.003f;            // share of a lamp's light at 1 m that is left out
constexpr int kMostOctaves = 9;             // of the grain
constexpr float kLeastCosine = 0.25f;       // of grazing rays, below which textures blur no further
constexpr float kInfinite = std::numeric_limits<float>::infinity();

Vec3 operator+(const Vec3& a, const Vec3& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
Vec3 operator-(const Vec3& a, const Vec3& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
Vec3 operator*(const Vec3& a, const Vec3& b) { return {a[0] * b[0], a[1] * b[1], a[2] * b[2]}; }
Vec3 operator*(float s, const Vec3& a) { return {s * a[0], s * a[1], s * a[2]}; }
float Dot(const Vec3& a, const Vec3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Vec3 Cross(const Vec3& a, const Vec3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Vec3 Normalize(const Vec3& a) { return (1.0f / std::sqrt(std::max(Dot(a, a), 1e-30f))) * a; }
float Mix(float a, float b, float share) { return a + share * (b - a); }
Vec3 Mix(const Vec3& a, const Vec3& b, float share) { return a + share * (b - a); }

// Mixes the bits of a number (the finalizer of SplitMix64).
std::uint64_t Scramble(std::uint64_t x) {
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ull;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebull;
  return x ^ (x >> 31);
}

float ToUnit(std::uint64_t bits) { return static_cast<float>(bits >> 40) * (1.0f / (1 << 24)); }

// Smooth noise in [-1, 1] with a feature a unit.
float MakeNoise(const Vec3& p, std::uint64_t seed) {
  const float fx = std::floor(p[0]), fy = std::floor(p[1]), fz = std::floor(p[2]);
  const auto ix = static_cast<std::int64_t>(fx), iy = static_cast<std::int64_t>(fy),
             iz = static_cast<std::int64_t>(fz);
  const auto ease = [](float t) { return t * t * (3 - 2 * t); };
  const float sx = ease(p[0] - fx), sy = ease(p[1] - fy), sz = ease(p[2] - fz);
  const auto at = [&](int dx, int dy, int dz) {
    const std::uint64_t key = static_cast<std::uint64_t>(ix + dx) * 0x9e3779b97f4a7c15ull ^
                              static_cast<std::uint64_t>(iy + dy) * 0xc2b2ae3d27d4eb4full ^
                              static_cast<std::uint64_t>(iz + dz) * 0x165667b19e3779f9ull;
    return 2 * ToUnit(Scramble(key + seed)) - 1;
  };
  const float x00 = Mix(at(0, 0, 0), at(1, 0, 0), sx), x10 = Mix(at(0, 1, 0), at(1, 1, 0), sx);
  const float x01 = Mix(at(0, 0, 1), at(1, 0, 1), sx), x11 = Mix(at(0, 1, 1), at(1, 1, 1), sx);
  return Mix(Mix(x00, x10, sy), Mix(x01, x11, sy), sz);
}

// Turns a point about two axes by angles that no wall has: lattices that lie along walls, or along
// each other, show as squares.
Vec3 TurnLattice(const Vec3& p) {
  constexpr float kCos = 0.8f, kSin = 0.6f;
  const float x = kCos * p[0] - kSin * p[1], y = kSin * p[0] + kCos * p[1];
  return {x, kCos * y - kSin * p[2], kSin * y + kCos * p[2]};
}

// Sums octaves of equal strength, as photographs have them, down to the width of a pixel.
float MakeGrain(const Vec3& point, float size, float width, std::uint64_t seed) {
  float sum = 0;
  Vec3 turned = TurnLattice(point);
  for (int octave = 0; octave < kMostOctaves; ++octave, size *= 0.5f) {
    const float left = size / std::max(width, 1e-6f) - 1;  // fades out at the pixel's width
    if (left <= 0) break;
    sum += std::min(left, 1.0f) * MakeNoise((1 / size) * turned, seed + octave);
    turned = TurnLattice(turned);
  }
  return sum;
}

}  // namespace

float Triangle::Middle(int axis) const {
  return corner[axis] + (edge1[axis] + edge2[axis]) * (1.0f / 3);
}

void Box::Add(const Triangle& t) {
  for (int k = 0; k < 3; ++k) {
    const float a = t.corner[k], b = a + t.edge1[k], c = a + t.edge2[k];
    low[k] = std::min({low[k], a, b, c});
    high[k] = std::max({high[k], a, b, c});
  }
}

void Box::Add(const Box& other) {
  for (int k = 0; k < 3; ++k) {
    low[k] = std::min(low[k], other.low[k]);
    high[k] = std::max(high[k], other.high[k]);
  }
}

float Box::MeasureArea() const {
  const Vec3 size = high - low;
  if (size[0] < 0) return 0;
  return size[0] * size[1] + size[1] * size[2] + size[2] * size[0];
}

// A sequence of numbers in [0, 1) that depends on the ray alone.
struct Tracer::Random {
  std::uint64_t state;
  int sample;  // of the pixel
  float Draw() {
    state += 0x9e3779b97f4a7c15ull;
    return ToUnit(Scramble(state));
  }
  Vec3 DrawOnSphere() {
    const float z = 2 * Draw() - 1, angle = 6.2831853f * Draw();
    const float radius = std::sqrt(std::max(0.0f, 1 - z * z));
    return {radius * std::cos(angle), radius * std::sin(angle), z};
  }
};

Tracer::Tracer(std::vector<Triangle> triangles, std::vector<Material> materials,
               std::vector<Texture> textures, const Light& light, std::vector<Lamp> lamps)
    : triangles_(std::move(triangles)),
      materials_(std::move(materials)),
      textures_(std::move(textures)),
      light_(light),
      lamps_(std::move(lamps)) {
  std::vector<int> order(triangles_.size());
  std::iota(order.begin(), order.end(), 0);
  nodes_.reserve(2 * triangles_.size() + 2);
  nodes_.emplace_back();
  Build(0, 0, static_cast<int>(order.size()), &order);
  std::vector<Triangle> sorted;
  sorted.reserve(order.size());
  for (const int index : order) sorted.push_back(triangles_[index]);
  triangles_ = std::move(sorted);
}

// Chooses axis and place of a cut by the surface area of the boxes on its sides times their numbers
// (MacDonald and Booth, "Heuristics for ray tracing using space subdivision", 1990).
std::pair<int, float> Tracer::ChooseSplit(const std::vector<int>& order, int begin, int end,
                                          const Vec3& low, const Vec3& high) const {
  struct Bin {
    Box box;
    int count = 0;
  };
  float best = kInfinite, place = 0;
  int chosen = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const float extent = high[axis] - low[axis];
    if (!(extent > 0)) continue;
    std::array<Bin, kBins> bins;
    for (int i = begin; i < end; ++i) {
      const Triangle& t = triangles_[order[i]];
      const float share = (t.Middle(axis) - low[axis]) / extent;
      Bin& bin = bins[std::min(static_cast<int>(share * kBins), kBins - 1)];
      bin.box.Add(t);
      ++bin.count;
    }
    std::array<float, kBins> below;
    Bin sum;
    for (int k = 0; k < kBins; ++k) {
      sum.box.Add(bins[k].box);
      sum.count += bins[k].count;
      below[k] = sum.box.MeasureArea() * sum.count;
    }
    sum = {};
    for (int k = kBins - 1; k > 0; --k) {
      sum.box.Add(bins[k].box);
      sum.count += bins[k].count;
      const float cost = below[k - 1] + sum.box.MeasureArea() * sum.count;
      if (cost < best) {
        best = cost;
        chosen = axis;
        place = low[axis] + extent * k / kBins;
      }
    }
  }
  return {chosen, place};
}

void Tracer::Build(int node, int begin, int end, std::vector<int>* order) {
  Box box;
  Vec3 low_middle = box.low, high_middle = box.high;
  for (int i = begin; i < end; ++i) {
    const Triangle& t = triangles_[(*order)[i]];
    box.Add(t);
    for (int k = 0; k < 3; ++k) {
      low_middle[k] = std::min(low_middle[k], t.Middle(k));
      high_middle[k] = std::max(high_middle[k], t.Middle(k));
    }
  }
  if (end - begin <= kLeaf) {
    nodes_[node] = {box, begin, end - begin};
    return;
  }
  const auto [axis, place] = ChooseSplit(*order, begin, end, low_middle, high_middle);
  const auto cut =
      std::stable_partition(order->begin() + begin, order->begin() + end,
                            [&](int index) { return triangles_[index].Middle(axis) < place; });
  int half = static_cast<int>(cut - order->begin());
  if (half == begin || half == end) half = (begin + end) / 2;
  const int first = static_cast<int>(nodes_.size());
  nodes_.emplace_back();
  nodes_.emplace_back();
  nodes_[node] = {box, first, 0};
  Build(first, begin, half, order);
  Build(first + 1, half, end, order);
}

// With `any`, the first found of the surfaces that stop light: neither panes nor those that glow,
// which are lamps.
Tracer::Hit Tracer::Find(const Vec3& origin, const Vec3& direction, float nearest, bool any) const {
  Hit hit{nearest};
  if (triangles_.empty()) return hit;
  Vec3 inverse;
  for (int k = 0; k < 3; ++k) {
    inverse[k] = 1 / (std::abs(direction[k]) < 1e-12f ? 1e-12f : direction[k]);
  }
  const auto enter = [&](const Node& node) {
    float near = 0, far = hit.distance;
    for (int k = 0; k < 3; ++k) {
      const float a = (node.box.low[k] - origin[k]) * inverse[k];
      const float b = (node.box.high[k] - origin[k]) * inverse[k];
      near = std::max(near, std::min(a, b));
      far = std::min(far, std::max(a, b));
    }
    return near <= far * 1.0000004f ? near : kInfinite;
  };
  std::array<std::pair<int, float>, 64> stack;
  int depth = 0;
  if (enter(nodes_[0]) < kInfinite) stack[depth++] = {0, 0.0f};
  while (depth > 0) {
    const auto [number, entered] = stack[--depth];
    if (entered > hit.distance) continue;
    const Node& node = nodes_[number];
    if (node.count == 0) {
      const float left = enter(nodes_[node.first]), right = enter(nodes_[node.first + 1]);
      const int near = left <= right ? 0 : 1;
      const float sooner = std::min(left, right), later = std::max(left, right);
      if (later < kInfinite) stack[depth++] = {node.first + 1 - near, later};
      if (sooner < kInfinite) stack[depth++] = {node.first + near, sooner};
      continue;
    }
    for (int i = node.first; i < node.first + node.count; ++i) {
      const Triangle& t = triangles_[i];
      const Vec3 p = Cross(direction, t.edge2);
      const float determinant = Dot(t.edge1, p);
      if (std::abs(determinant) < 1e-20f) continue;
      const float inverted = 1 / determinant;
      const Vec3 s = origin - t.corner;
      const float u = Dot(s, p) * inverted;
      if (u < 0 || u > 1) continue;
      const Vec3 q = Cross(s, t.edge1);
      const float v = Dot(direction, q) * inverted;
      if (v < 0 || u + v > 1) continue;
      const float distance = Dot(t.edge2, q) * inverted;
      if (distance <= 0 || distance >= hit.distance) continue;
      const Material& material = materials_[t.material];
      if (material.cut_out > 0 && IsCutOut(t, u, v)) continue;
      if (any && (material.glass > 0 || material.emission > 0)) continue;
      hit = {distance, i, u, v};
      if (any) return hit;
    }
  }
  return hit;
}

bool Tracer::IsFree(const Vec3& origin, const Vec3& direction, float length) const {
  return Find(origin, direction, length, true).triangle < 0;
}

bool Tracer::IsCutOut(const Triangle& triangle, float u, float v) const {
  return LookUpTexture(triangle, u, v, 0)[3] < 0.5f;
}

std::array<float, 4> Tracer::LookUpTexture(const Triangle& t, float u, float v, float width) const {
  const int index = static_cast<int>(materials_[t.material].texture);
  if (index < 0) return {1, 1, 1, 1};
  const std::vector<Texture::Level>& levels = textures_[index].levels;
  const float wanted = std::log2(std::max(width * t.texels, 1.0f));
  const int number = std::min(static_cast<int>(wanted + 0.5f), static_cast<int>(levels.size()) - 1);
  const Texture::Level& level = levels[number];
  const float w = 1 - u - v;
  float at[2];
  for (int k = 0; k < 2; ++k) {
    const float place = w * t.uv[0][k] + u * t.uv[1][k] + v * t.uv[2][k];
    at[k] = place - std::floor(place);
  }
  const float x = at[0] * level.width - 0.5f, y = (1 - at[1]) * level.height - 0.5f;
  const float column = std::floor(x), row = std::floor(y);
  const auto wrap = [](int i, int n) { return ((i % n) + n) % n; };
  const int x0 = wrap(static_cast<int>(column), level.width), x1 = wrap(x0 + 1, level.width);
  const int y0 = wrap(static_cast<int>(row), level.height), y1 = wrap(y0 + 1, level.height);
  std::array<float, 4> out;
  for (int k = 0; k < 4; ++k) {
    const auto pixel = [&](int py, int px) {
      return level.pixels[4 * (static_cast<std::size_t>(py) * level.width + px) + k];
    };
    out[k] = Mix(Mix(pixel(y0, x0), pixel(y0, x1), x - column),
                 Mix(pixel(y1, x0), pixel(y1, x1), x - column), y - row);
  }
  return out;
}

Vec3 Tracer::LookUpSky(const Vec3& direction, bool with_sun) const {
  const float up = std::max(direction[2], 0.0f);
  Vec3 color = Mix(light_.horizon, light_.zenith, std::pow(up, 0.45f));
  if (light_.clouds > 0 && direction[2] > 0.02f) {
    // A plane of clouds, one unit above the eye.
    const Vec3 place{direction[0] / (up + 0.1f), direction[1] / (up + 0.1f), 0.5f};
    const auto seed = static_cast<std::uint64_t>(light_.seed);
    const float thick = 0.3f * MakeGrain(0.8f * place, 1.6f, 0.02f, seed) + 2 * light_.clouds - 1;
    const float cover = std::clamp(2.5f * thick, 0.0f, 1.0f) * std::min(1.0f, 6 * up);
    const float bright = 1.15f - 0.35f * std::clamp(thick, 0.0f, 1.0f);
    color = Mix(color, bright * Mix(light_.horizon, Vec3{1, 1, 1}, 0.3f), cover);
  }
  if (with_sun) {
    const float glow = std::max(Dot(direction, light_.toward_sun), 0.0f);
    color = color + std::pow(glow, light_.shine_spread) * light_.sun;
  }
  return color;
}

// Light of the surroundings: the same directions at every point, others for each ray of a pixel, so
// that it has no noise; what stops a ray darkens the less the further away it is.
Vec3 Tracer::GatherSurroundings(const Vec3& point, const Vec3& normal, int sample) const {
  Vec3 light{0, 0, 0};
  for (int k = 0; k < kDirections; ++k) {
    const int number = sample * kDirections + k;
    const float z = std::fmod(0.5f + 0.618034f * number, 1.0f) * 2 - 1;
    const float angle = 2.399963f * number, radius = std::sqrt(1 - z * z);
    const Vec3 spot{radius * std::cos(angle), radius * std::sin(angle), z};
    const Vec3 toward = Normalize(normal + 0.98f * spot);
    const Hit hit = Find(point, toward, light_.reach, false);
    const float free = hit.triangle < 0 ? 1.0f : std::pow(hit.distance / light_.reach, 0.7f);
    const Vec3 sky = toward[2] > 0 ? LookUpSky(toward, false) : kBounced;
    light = light + Mix(kIndirect, 1.0f, free) * Mix(Vec3{1, 1, 1}, sky, light_.sky_share);
  }
  return (1.0f / kDirections) * (light_.ambient * light);
}

Vec3 Tracer::GatherLight(const Vec3& point, const Vec3& normal, Random* random) const {
  Vec3 light = GatherSurroundings(point, normal, random->sample);
  const float to_sun = Dot(normal, light_.toward_sun);
  if (to_sun > 0 && light_.sun[0] > 0) {
    const Vec3 toward = Normalize(light_.toward_sun + 0.005f * random->DrawOnSphere());
    if (IsFree(point, toward, kInfinite)) light = light + to_sun * light_.sun;
  }
  for (const Lamp& lamp : lamps_) {
    const Vec3 way = lamp.place + lamp.radius * random->DrawOnSphere() - point;
    const float square = Dot(way, way), length = std::sqrt(square);
    const Vec3 toward = (1 / std::max(length, 1e-6f)) * way;
    const float strength = Dot(toward, normal) / (square + kLampSoftness);
    if (strength > kFaint && IsFree(point, toward, length)) light = light + strength * lamp.light;
  }
  return light;
}

Vec3 Tracer::Shade(const Vec3& origin, const Vec3& direction, const Hit& hit, float way, int depth,
                   Random* random) const {
  const Triangle& t = triangles_[hit.triangle];
  const Material& m = materials_[t.material];
  const float w = 1 - hit.u - hit.v;
  Vec3 normal = Normalize(w * t.normals[0] + hit.u * t.normals[1] + hit.v * t.normals[2]);
  if (Dot(normal, direction) > 0) normal = -1.0f * normal;
  const float cosine = std::max(-Dot(normal, direction), 0.0f);
  const Vec3 point = origin + hit.distance * direction;
  const float width = way / std::max(cosine, kLeastCosine);  // of a pixel on the surface, metres
  const std::array<float, 4> texel = LookUpTexture(t, hit.u, hit.v, width);
  Vec3 color = m.color * Vec3{texel[0], texel[1], texel[2]};
  if (m.grain > 0) {
    const auto seed = static_cast<std::uint64_t>(t.material) << 32;
    const float grain = m.grain * MakeGrain(point, m.grain_size, width, seed);
    color = std::exp(std::clamp(grain, -2.5f, 1.2f)) * color;
    for (float& c : color) c = std::min(c, 0.95f);
  }
  if (m.emission > 0) return m.emission * color;
  const Vec3 lifted = point + (kLeastLift + kLift * hit.distance) * normal;
  const Vec3 matt = color * GatherLight(lifted, normal, random);
  if (m.gloss <= 0 || depth >= kMostBounces) return matt;
  const float fresnel = m.gloss + (1 - m.gloss) * std::pow(1 - cosine, 5.0f);
  Vec3 mirrored = direction + (2 * cosine) * normal;
  mirrored = Normalize(mirrored + m.roughness * random->DrawOnSphere());
  if (Dot(mirrored, normal) <= 0) return matt;
  return Mix(matt, Follow(lifted, mirrored, way, hit.distance, depth + 1, random, nullptr),
             fresnel);
}

Vec3 Tracer::Follow(const Vec3& origin, const Vec3& direction, float spread, float way, int depth,
                    Random* random, Seen* seen) const {
  const Hit hit = Find(origin, direction, kInfinite, false);
  if (hit.triangle < 0) {
    if (seen != nullptr) seen->body = -1;
    return random == nullptr ? Vec3{0, 0, 0} : LookUpSky(direction, true);
  }
  // Of a reflected ray `spread` is already a width: it grows no further than this.
  const float width = depth == 0 ? (way + hit.distance) * spread : 2 * spread;
  const Triangle& t = triangles_[hit.triangle];
  const Material& m = materials_[t.material];
  if (m.glass > 0 && depth < kMostBounces) {
    const Vec3 beyond = origin + (hit.distance * (1 + kLift) + kLeastLift) * direction;
    const Vec3 through = Follow(beyond, direction, spread, way + hit.distance, depth, random, seen);
    if (seen != nullptr) seen->distance += hit.distance;
    if (random == nullptr) return through;
    const float cosine = std::abs(Dot(Normalize(t.normals[0]), direction));
    const float fresnel = 0.08f + 0.92f * std::pow(1 - cosine, 5.0f);
    Vec3 normal = Normalize(t.normals[0]);
    if (Dot(normal, direction) > 0) normal = -1.0f * normal;
    const Vec3 lifted =
        origin + hit.distance * direction + (kLeastLift + kLift * hit.distance) * normal;
    const Vec3 mirrored = direction + (2 * cosine) * normal;
    const Vec3 reflected = Follow(lifted, mirrored, width, 0, depth + 1, random, nullptr);
    return Mix(m.color * through, reflected, fresnel);
  }
  if (seen != nullptr) {
    seen->distance = hit.distance;
    seen->body = t.body;
  }
  if (random == nullptr) return {0, 0, 0};
  return Shade(origin, direction, hit, width, depth, random);
}

Seen Tracer::Trace(const Vec3& origin, const Vec3& direction, float spread, std::uint64_t number,
                   int sample, bool with_light) const {
  Random random{Scramble(number), sample};
  Seen seen{{0, 0, 0}, kInfinite, -1};
  seen.color = Follow(origin, direction, spread, 0, 0, with_light ? &random : nullptr, &seen);
  return seen;
}

}  // namespace proving
