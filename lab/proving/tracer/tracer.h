// Traces rays through textured triangles under a sky: the pictures of the proving ground.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

namespace proving {

using Vec3 = std::array<float, 3>;

// How a surface looks. The order of the fields is that of the rows which Python passes.
struct Material {
  Vec3 color;        // linear albedo, or light of a glowing surface; multiplies the texture
  float texture;     // index, or below 0: none
  float gloss;       // reflectance at normal incidence: 0 matt, 0.04 varnish, 1 mirror
  float roughness;   // tangent of the spread of reflections
  float emission;    // light that leaves the surface, times its colour; 0: it is lit
  float cut_out;     // above 0: transparent where the texture's alpha is below one half
  float glass;       // above 0: a thin pane, seen through
  float grain;       // strength of the noise in space that the albedo is multiplied by
  float grain_size;  // its largest feature, metres
};
constexpr int kMaterialFields = 11;
static_assert(sizeof(Material) == kMaterialFields * sizeof(float));

// Light from outside. The same rule for the order.
struct Light {
  Vec3 toward_sun;  // unit
  Vec3 sun;         // light on a surface that faces it
  Vec3 zenith;      // light of the sky
  Vec3 horizon;
  Vec3 ambient;        // light from open surroundings, with the sky's share by direction
  float sky_share;     // 0: surroundings shine alike from everywhere, 1: as the sky does
  float clouds;        // 0 none to 1 overcast with structure
  float reach;         // metres beyond which surroundings do not darken
  float seed;          // of the clouds
  float shine_spread;  // cosine exponent of the sun's glow in the sky and in reflections
};
constexpr int kLightFields = 20;
static_assert(sizeof(Light) == kLightFields * sizeof(float));

struct Lamp {
  Vec3 place;
  Vec3 light;    // on a surface that faces it from 1 m
  float radius;  // of its ball, metres: soft shadows
};
constexpr int kLampFields = 7;

struct Texture {
  struct Level {
    int height, width;
    std::vector<float> pixels;  // RGBA, linear
  };
  std::vector<Level> levels;  // each half the one before
};

struct Triangle {
  Vec3 corner, edge1, edge2;
  std::array<Vec3, 3> normals;
  std::array<std::array<float, 2>, 3> uv;
  int material, body;
  float texels;  // of the largest level, a metre

  float Middle(int axis) const;
};

struct Box {
  Vec3 low{std::numeric_limits<float>::infinity(), std::numeric_limits<float>::infinity(),
           std::numeric_limits<float>::infinity()};
  Vec3 high{-low[0], -low[1], -low[2]};

  void Add(const Triangle& triangle);
  void Add(const Box& other);
  float MeasureArea() const;  // half of the surface; 0 if nothing was added
};

// What a ray sees first, panes left out.
struct Seen {
  Vec3 color;
  float distance;  // infinite: the sky
  int body;        // of the triangle; -1: the sky
};

class Tracer {
 public:
  Tracer(std::vector<Triangle> triangles, std::vector<Material> materials,
         std::vector<Texture> textures, const Light& light, std::vector<Lamp> lamps);

  // spread: angle between neighbouring pixels, radians; number: of the ray, seeds its samples;
  // sample: of its pixel. Without light the color is black, for a quarter of the time.
  Seen Trace(const Vec3& origin, const Vec3& direction, float spread, std::uint64_t number,
             int sample, bool with_light) const;

 private:
  struct Node {
    Box box;
    int first, count;  // count 0: an inner node, whose children are first and first + 1
  };
  struct Hit {
    float distance;
    int triangle = -1;
    float u = 0, v = 0;
  };
  struct Random;

  std::pair<int, float> ChooseSplit(const std::vector<int>& order, int begin, int end,
                                    const Vec3& low, const Vec3& high) const;
  void Build(int node, int begin, int end, std::vector<int>* order);
  Hit Find(const Vec3& origin, const Vec3& direction, float nearest, bool any) const;
  bool IsFree(const Vec3& origin, const Vec3& direction, float length) const;
  bool IsCutOut(const Triangle& triangle, float u, float v) const;
  Vec3 Shade(const Vec3& origin, const Vec3& direction, const Hit& hit, float spread, int depth,
             Random* random) const;
  // random: none if light is not asked for.
  Vec3 Follow(const Vec3& origin, const Vec3& direction, float spread, float way, int depth,
              Random* random, Seen* seen) const;
  Vec3 GatherSurroundings(const Vec3& point, const Vec3& normal, int sample) const;
  Vec3 GatherLight(const Vec3& point, const Vec3& normal, Random* random) const;
  Vec3 LookUpSky(const Vec3& direction, bool with_sun) const;
  std::array<float, 4> LookUpTexture(const Triangle& triangle, float u, float v, float width) const;

  std::vector<Triangle> triangles_;
  std::vector<Material> materials_;
  std::vector<Texture> textures_;
  Light light_;
  std::vector<Lamp> lamps_;
  std::vector<Node> nodes_;
};

}  // namespace proving
