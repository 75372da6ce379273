// Tests gsut/raster: tiles and their rays, lists, misses.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/activations.h"
#include "gsut/raster/bin_tiles.h"
#include "gsut/raster/render.h"
#include "gsut/raster/tile_grid.h"
#include "random_gaussians.h"

namespace gsut {
namespace {

using namespace testing_scenes;

// Unit rays from frame, s and t in float: a few roundings of 6e-8 at s up to 10; observed 2.4e-7.
constexpr double kRayError = 1e-6;
// A pixel this much above the cut-off, relative, is above it in float, too: alpha of a needle whose
// thickness is 1e-4 of its distance wobbles by 6e-8 / 1e-4 x D x alpha.
constexpr double kMissMargin = 2e-3;

constexpr SceneKind kKinds[] = {
    {"ordinary", 1.0, 6.0, 0.005, 0.2, 0.5, 0.0}, {"small", 1.0, 6.0, 0.0005, 0.02, 0.7, 0.0},
    {"needles", 1.0, 6.0, 0.01, 0.1, 1.5, 0.0},   {"close", 0.05, 0.5, 0.05, 1.0, 0.7, 0.0},
    {"huge", 1.0, 6.0, 0.5, 5.0, 0.7, 0.0},
};

RenderSettings Settings() { return {}; }

TEST(RendererTest, WrongArgumentsRaiseInputError) {
  const Camera camera("pinhole", {8, 8, 8, 8}, 16, 16);
  OwnedGaussians<float> arrays(2);
  const GaussiansView<const float> whole = arrays.View();
  std::vector<float> image(3 * 16 * 16);
  std::uint8_t valid = 0, touched[2] = {};
  double number = 0.0;
  Splats splats;
  Renderer renderer;
  const auto render = [&](const GaussiansView<const float>& gaussians, float* to, int channels) {
    RenderJob job = {camera, CameraMotion(Pose{})};
    job.image = to;
    job.channels.count = channels;
    renderer.Render(gaussians, job);
  };
  GaussiansView<const float> missing = whole, negative = whole, harmonics = whole;
  missing.quats = nullptr;
  negative.size = -1;
  harmonics.sh_coefficients = 5;
  for (const auto& wrong : {missing, negative, harmonics}) {
    EXPECT_THROW(render(wrong, image.data(), 0), InputError);
    EXPECT_THROW(Project(wrong, camera, {}, {}, {}, &splats), InputError);
  }
  EXPECT_THROW(render(whole, nullptr, 0), InputError);
  EXPECT_THROW(render(whole, image.data(), 2), InputError);
  EXPECT_THROW(render(whole, image.data(), -1), InputError);
  EXPECT_THROW(Project(whole, camera, {}, {}, {}, nullptr), InputError);
  GaussiansView<const double> in_double;
  in_double.size = 2;
  EXPECT_THROW(ProjectReference(in_double, camera, {}, {}, nullptr, nullptr, nullptr), InputError);
  EXPECT_THROW(renderer.AddFisher(nullptr, &number), InputError);  // before a render
  render(whole, image.data(), 0);
  EXPECT_THROW(renderer.AddFisher(nullptr, nullptr), InputError);
  EXPECT_THROW(renderer.AddSupport(nullptr, nullptr, &number), InputError);
  EXPECT_THROW(renderer.AddSignificance(nullptr, &number, nullptr, nullptr), InputError);
  EXPECT_THROW(renderer.AddFeatures(image.data(), -1, image.data()), InputError);
  EXPECT_THROW(renderer.Rays(nullptr, image.data()), InputError);
  EXPECT_THROW(renderer.Jacobian(std::vector<std::uint32_t>(2), nullptr, &number), InputError);
  const ImageGradients no_image = {nullptr};
  const GradientRows rows = {arrays.MutableView(), touched};
  EXPECT_THROW(renderer.Backward(no_image, rows, nullptr), InputError);
  EXPECT_THROW(camera.Project(1, nullptr, &number, &valid), InputError);
  EXPECT_THROW(camera.Unproject(-1, &number, &number, &valid), InputError);
  const int beyond[] = {4};
  double point[3] = {0, 0, 1}, pixel[2];
  EXPECT_THROW(camera.ProjectJacobian(1, point, pixel, &valid, nullptr, pixel, beyond), InputError);
}

TEST(TileGridTest, RaysAreReproducedOnEveryLensAndVectorWidth) {
  int ran = 0;
  for (const NamedCamera& lens : EveryLens(70)) {
    const RayTable& table = lens.camera.Rays();
    for (const int lanes : {4, 8, 16}) {
      const std::shared_ptr<const TileGrid> grid = TilesOf(lens.camera, lanes);
      ASSERT_FALSE(grid->too_wide) << lens.name;
      std::int64_t rays = 0;
      double worst = 0.0;
      for (int y = 0; y < grid->height; ++y) {
        for (int x = 0; x < grid->width; ++x) {
          const int tile = y / kTileSize * grid->tiles_x + x / kTileSize;
          const std::size_t i =
              static_cast<std::size_t>(tile) * kTilePixels +
              static_cast<std::size_t>(grid->PixelOffset(x % kTileSize, y % kTileSize));
          const std::size_t p =
              static_cast<std::size_t>(y) * static_cast<std::size_t>(grid->width) +
              static_cast<std::size_t>(x);
          ASSERT_EQ(grid->start[i], table.valid[p] ? 1.0f : 0.0f);
          if (!table.valid[p]) continue;
          const RayBundle& bundle = grid->bundles[static_cast<std::size_t>(tile)];
          Eigen::Vector3d ray;
          for (int k = 0; k < 3; ++k) {
            ray[k] = bundle.values[RayBundle::kFrame + k] +
                     static_cast<double>(grid->s[i]) * bundle.values[RayBundle::kFrame + 3 + k] +
                     static_cast<double>(grid->t[i]) * bundle.values[RayBundle::kFrame + 6 + k];
          }
          ASSERT_NEAR(ray.norm() / grid->length[i], 1.0, kRayError);
          const Eigen::Vector3d expected = Eigen::Map<const Eigen::Vector3d>(&table.rays[3 * p]);
          worst = std::max(worst, (ray.normalized() - expected).norm());
          // The box of the tile holds it.
          for (int k = 0; k < 2; ++k) {
            const double value = k == 0 ? grid->s[i] : grid->t[i];
            ASSERT_LE(std::abs(value - bundle.values[RayBundle::kCenter + k]),
                      bundle.values[RayBundle::kHalf + k]);
          }
          ++rays;
        }
      }
      EXPECT_LT(worst, kRayError) << lens.name;
      EXPECT_GT(rays, 500) << lens.name;
      ++ran;
    }
  }
  EXPECT_EQ(ran, 3 * static_cast<int>(EveryLens(70).size()));
}

TEST(TileGridTest, ImageOfFewPixelsOverAPanoramaIsTooWide) {
  const Camera panorama("kannala_brandt", {1.5, 1.5, 4.0, 4.0}, 8, 8);
  EXPECT_TRUE(TilesOf(panorama, 8)->too_wide);
  const Camera narrow("kannala_brandt", {15.0, 15.0, 4.0, 4.0}, 8, 8);
  EXPECT_FALSE(TilesOf(narrow, 8)->too_wide);
}

// A frame of random rectangles and keys (many of them equal), as the records stage leaves it.
Frame RandomFrame(const TileGrid& grid, std::int64_t n, Draws* draws) {
  Frame frame;
  frame.size = n;
  frame.rects.resize(static_cast<std::size_t>(n));
  frame.order_key.resize(static_cast<std::size_t>(n));
  frame.row_spans.resize(static_cast<std::size_t>((n + kRecordsPart - 1) / kRecordsPart));
  for (std::int64_t i = 0; i < n; ++i) {
    const std::size_t j = static_cast<std::size_t>(i);
    // Negative keys (order by z) and both zeros among them.
    const float key = static_cast<float>(draws->Index(41) - 20) * 0.37f;
    frame.order_key[j] = draws->Uniform(0, 1) < 0.5 ? key : -key;
    TileRect& rect = frame.rects[j];
    rect = {};
    if (draws->Uniform(0, 1) < 0.3) continue;  // not seen
    const bool is_large = draws->Uniform(0, 1) < 0.1;
    const int width = is_large ? grid.tiles_x : 1 + static_cast<int>(draws->Index(5));
    const int height = is_large ? grid.tiles_y : 1 + static_cast<int>(draws->Index(5));
    rect.x0 = static_cast<std::uint16_t>(draws->Index(grid.tiles_x - width + 1));
    rect.y0 = static_cast<std::uint16_t>(draws->Index(grid.tiles_y - height + 1));
    rect.x1 = static_cast<std::uint16_t>(rect.x0 + width);
    rect.y1 = static_cast<std::uint16_t>(rect.y0 + height);
    if (rect.Area() > TileRect::kMaxMasked) {
      std::vector<RowSpan>& spans = frame.row_spans[j / static_cast<std::size_t>(kRecordsPart)];
      rect.tiles = spans.size();
      for (int y = rect.y0; y < rect.y1; ++y) {
        const int begin = rect.x0 + static_cast<int>(draws->Index(width));
        const int end = begin + static_cast<int>(draws->Index(rect.x1 - begin + 1));
        spans.push_back({static_cast<std::uint16_t>(begin), static_cast<std::uint16_t>(end)});
      }
    } else {
      for (std::uint32_t bit = 0; bit < rect.Area(); ++bit) {
        if (draws->Uniform(0, 1) < 0.7) rect.tiles |= std::uint64_t{1} << bit;
      }
    }
  }
  return frame;
}

TEST(BinTilesTest, ListsMatchAStableSortOnAnyThreadCount) {
  const Camera camera("pinhole", {100.0, 100.0, 96.0, 80.0}, 192, 160);
  const std::shared_ptr<const TileGrid> grid = TilesOf(camera, 8);
  for (const std::int64_t n : {0, 1, 2, 1000, 40000}) {
    Draws draws(3, static_cast<std::uint64_t>(n));
    const Frame start = RandomFrame(*grid, n, &draws);
    // By definition: all seen Gaussians in order, each into its tiles.
    std::vector<std::uint32_t> order(static_cast<std::size_t>(n));
    std::iota(order.begin(), order.end(), 0u);
    std::erase_if(order, [&](std::uint32_t i) { return start.rects[i].x0 >= start.rects[i].x1; });
    std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
      return start.order_key[a] < start.order_key[b];
    });
    std::vector<std::vector<std::uint32_t>> lists(static_cast<std::size_t>(grid->num_tiles()));
    for (const std::uint32_t i : order) {
      start.rects[i].ForEachTile(start.SpansOf(i), [&](int x, int y) {
        lists[static_cast<std::size_t>(y * grid->tiles_x + x)].push_back(i);
      });
    }
    for (const int threads : {1, 2, 8}) {
      SetNumThreads(threads);
      Frame frame = start;
      BinTiles(*grid, &frame);
      ASSERT_TRUE(std::equal(order.begin(), order.end(), frame.order.begin(), frame.order.end()));
      std::vector<int> slots(frame.pairs.size(), 0);
      for (std::size_t tile = 0; tile < lists.size(); ++tile) {
        const std::uint32_t begin = frame.tile_begin[tile];
        ASSERT_EQ(frame.tile_begin[tile + 1] - begin, lists[tile].size());
        for (std::size_t k = 0; k < lists[tile].size(); ++k) {
          const TilePair pair = frame.pairs[begin + k];
          ASSERT_EQ(pair.gaussian, lists[tile][k]) << "tile " << tile;
          // A slot of its own, among those of its Gaussian.
          ASSERT_GE(pair.slot, frame.slot_begin[pair.gaussian]);
          ASSERT_LT(pair.slot, frame.slot_begin[pair.gaussian + 1]);
          ++slots.at(pair.slot);
        }
      }
      ASSERT_EQ(std::count(slots.begin(), slots.end(), 1),
                static_cast<std::ptrdiff_t>(slots.size()));
    }
  }
  SetNumThreads(0);
}

// Whether the rectangle of Gaussian i holds the tile.
bool HoldsTile(const Frame& frame, std::size_t i, int tile_x, int tile_y) {
  bool holds = false;
  if (frame.rects[i].x0 >= frame.rects[i].x1) return false;
  frame.rects[i].ForEachTile(frame.SpansOf(i),
                             [&](int x, int y) { holds = holds || (x == tile_x && y == tile_y); });
  return holds;
}

// One Gaussian in the camera frame: whether a ray meets it with alpha above a cut-off.
struct SeenGaussian {
  Eigen::Matrix3d whiten;
  Eigen::Vector3d center;
  Eigen::Array3d scale;
  double distance;
  double cutoff;  // of D^2; negative: never seen

  SeenGaussian(const OwnedGaussians<double>& g, std::size_t i, const Pose& pose, double alpha_min) {
    double r[9];
    RotationFromQuaternion(&g.quats[4 * i], r);
    const Eigen::Matrix3d axes =
        pose.rotation * Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r);
    const Eigen::Vector3d mean =
        pose.rotation * Eigen::Map<const Eigen::Vector3d>(&g.means[3 * i]) + pose.translation;
    scale = Eigen::Map<const Eigen::Array3d>(&g.log_scales[3 * i]).exp();
    whiten = scale.inverse().matrix().asDiagonal() * axes.transpose();
    center = whiten * mean;
    distance = mean.norm();
    cutoff = 2.0 * std::log(Sigmoid(g.opacity_logits[i]) / alpha_min);
  }

  bool IsMetBy(const double* ray) const {
    const Eigen::Vector3d w = whiten * Eigen::Map<const Eigen::Vector3d>(ray);
    const double along = center.dot(w);
    return along > 0.0 && center.squaredNorm() - along * along / w.squaredNorm() < cutoff;
  }

  // Whether a pixel of the tile sees it.
  bool IsSeenIn(const Camera& camera, int tile_x, int tile_y) const {
    const RayTable& table = camera.Rays();
    const int x1 = std::min((tile_x + 1) * kTileSize, camera.width());
    const int y1 = std::min((tile_y + 1) * kTileSize, camera.height());
    for (int y = tile_y * kTileSize; y < y1; ++y) {
      for (int x = tile_x * kTileSize; x < x1; ++x) {
        const std::size_t p =
            static_cast<std::size_t>(y) * static_cast<std::size_t>(camera.width()) +
            static_cast<std::size_t>(x);
        if (table.valid[p] && IsMetBy(&table.rays[3 * p])) return true;
      }
    }
    return false;
  }
};

// Sums over scenes.
struct MissCount {
  std::int64_t pairs = 0;   // (Gaussian, camera)
  std::int64_t seen = 0;    // tiles with a pixel that sees the Gaussian
  std::int64_t listed = 0;  // tiles that list it
  std::int64_t missed = 0;  // seen, not listed
};

// Renders, then looks for tiles that see a Gaussian and do not list it: in all tiles, or in the
// ones within one tile of the splat's centre.
void CountMisses(const NamedCamera& lens, const SceneKind& kind, std::int64_t n, bool is_near_only,
                 std::uint64_t stream, MissCount* count) {
  const Camera& camera = lens.camera;
  Draws draws(4, stream);
  const Pose pose = RandomPose(&draws);
  const auto g = GaussiansInView(camera, pose, n, kind, &draws);
  const auto exact = ToDouble(g);
  Renderer renderer;
  std::vector<float> image(3 * camera.Rays().valid.size());
  RenderJob job = {camera, pose};
  job.keep_for_backward = false;
  job.image = image.data();
  renderer.Render(g.View(), job);
  const Frame& frame = renderer.frame();
  const Splats& splats = renderer.splats();
  const int tiles_x = (camera.width() + kTileSize - 1) / kTileSize;
  const int tiles_y = (camera.height() + kTileSize - 1) / kTileSize;
  const double alpha_min = Settings().rule.alpha_min * (1.0 + kMissMargin);
  count->pairs += n;
  count->listed += renderer.num_pairs();
  for (std::size_t i = 0; i < static_cast<std::size_t>(n); ++i) {
    const SeenGaussian seen(exact, i, pose, alpha_min);
    if (seen.cutoff <= 0.0) continue;
    int x0 = 0, x1 = tiles_x, y0 = 0, y1 = tiles_y;
    if (is_near_only) {
      if (!std::isfinite(splats.u[i]) || std::abs(splats.u[i]) > 1e5f ||
          std::abs(splats.v[i]) > 1e5f) {
        continue;
      }
      const int x = static_cast<int>(splats.u[i]) / kTileSize;
      const int y = static_cast<int>(splats.v[i]) / kTileSize;
      x0 = std::clamp(x - 1, 0, tiles_x);
      x1 = std::clamp(x + 2, 0, tiles_x);
      y0 = std::clamp(y - 1, 0, tiles_y);
      y1 = std::clamp(y + 2, 0, tiles_y);
    }
    for (int y = y0; y < y1; ++y) {
      for (int x = x0; x < x1; ++x) {
        if (!seen.IsSeenIn(camera, x, y)) continue;
        ++count->seen;
        if (HoldsTile(frame, i, x, y)) continue;
        ++count->missed;
        ADD_FAILURE() << lens.name << ", " << kind.name << ": tile " << x << ", " << y
                      << " misses Gaussian " << i << ", status "
                      << static_cast<int>(splats.status[i]) << ", at pixel " << splats.u[i] << ", "
                      << splats.v[i] << ", distance " << seen.distance << ", scales "
                      << seen.scale.transpose();
      }
    }
  }
}

// (Gaussian, camera) pairs of a test of misses, over all lenses.
constexpr std::int64_t kMissPairs = 100000;

void ExpectNoneMissed(const MissCount& count) {
  std::printf("%lld pairs: %lld tiles missed of %lld seen; %lld listed\n",
              static_cast<long long>(count.pairs), static_cast<long long>(count.missed),
              static_cast<long long>(count.seen), static_cast<long long>(count.listed));
  EXPECT_EQ(count.missed, 0);
  EXPECT_GE(count.pairs, kMissPairs);
  EXPECT_GT(count.seen, count.pairs / 2);
}

TEST(RendererTest, NoTileMissesAGaussianThatOneOfItsPixelsSees) {
  const std::vector<NamedCamera> lenses = EveryLens(48);
  const std::int64_t scenes = static_cast<std::int64_t>(lenses.size() * std::size(kKinds));
  MissCount count;
  std::uint64_t stream = 0;
  for (const NamedCamera& lens : lenses) {
    for (const SceneKind& kind : kKinds) {
      CountMisses(lens, kind, kMissPairs / scenes + 1, false, stream++, &count);
    }
  }
  ExpectNoneMissed(count);
}

TEST(RendererTest, NoTileMissesASmallGaussianOfALargeImage) {
  // Small splats are bounded by their ellipse alone: here the lens' bending counts, most of all
  // towards the edge of its domain.
  constexpr SceneKind kSmall = {"small", 1.0, 6.0, 0.003, 0.03, 0.7, 1.0};
  const std::vector<NamedCamera> lenses = EveryLens(500);
  MissCount count;
  std::uint64_t stream = 1000;
  for (const NamedCamera& lens : lenses) {
    CountMisses(lens, kSmall, kMissPairs / static_cast<std::int64_t>(lenses.size()) + 1, true,
                stream++, &count);
  }
  ExpectNoneMissed(count);
}

}  // namespace
}  // namespace gsut
