// Tests gsut/raster: tiles and their rays, lists; images are held to the reference from Python.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/raster/bin_tiles.h"
#include "gsut/raster/reference/reference.h"
#include "gsut/raster/render.h"
#include "gsut/raster/tile_grid.h"
#include "random_gaussians.h"

namespace gsut {
namespace {

using namespace testing_scenes;

// Unit rays from frame, s and t in float: a few roundings of 6e-8 at s up to 10; observed 2.4e-7.
constexpr double kRayError = 1e-6;
// A larger difference of a colour is a choice at a cut-off; see RENDER_FLIP in tests/tolerances.
constexpr double kFlip = 1e-4;
constexpr double kFlipsAValue = 1e-3;
constexpr double kGradientError = 2e-4;  // relative, of means; as RENDER_GRADIENT
// Image and gradients of one view against the double reference; pixels on a discontinuity of the
// rule, where float may choose otherwise, are counted and left out of the loss.
void ExpectReference(const NamedCamera& lens, const OwnedGaussians<float>& g,
                     const CameraMotion& motion, std::int64_t* pixels, std::int64_t* flips) {
  std::vector<float> image(3 * lens.camera.Rays().valid.size());
  RenderJob job = {lens.camera, motion};
  job.image = image.data();
  Renderer renderer;
  renderer.Render(g.View(), job);
  const auto exact = ToDouble(g);
  const ReferenceImage truth = RenderReference(exact.View(), lens.camera, motion, {});
  std::vector<float> weights(image.size());
  for (std::size_t i = 0; i < image.size(); ++i) {
    const bool same = std::abs(image[i] - truth.image[i]) < kFlip;
    weights[i] = same ? image[i] : 0.0F;
    *flips += !same;
  }
  *pixels += static_cast<std::int64_t>(image.size());
  OwnedGaussians<float> found(g.size());
  OwnedGaussians<double> expected(g.size());
  std::vector<std::uint8_t> touched(static_cast<std::size_t>(g.size()));
  double to_poses[12];
  renderer.Backward({weights.data()}, {found.MutableView(), touched.data(), true}, to_poses);
  const std::vector<double> in_double(weights.begin(), weights.end());
  RenderReferenceBackward(exact.View(), lens.camera, motion, {}, {in_double.data()},
                          expected.MutableView(), to_poses);
  double off = 0.0, size = 0.0;
  for (std::size_t i = 0; i < found.means.size(); ++i) {
    off += std::pow(found.means[i] - expected.means[i], 2);
    size += std::pow(expected.means[i], 2);
  }
  EXPECT_GT(size, 0.0) << lens.name;
  EXPECT_LT(std::sqrt(off / size), kGradientError) << lens.name;
}

// Of every lens, still and rolling: what the sanitizers see of the kernels, and Arm and Windows
// run.
TEST(RendererTest, EveryLensGivesImageAndGradientsOfTheDoubleReference) {
  constexpr SceneKind kKind = {"ordinary", 1.0, 6.0, 0.005, 0.2, 0.5, 0.0};
  std::int64_t pixels = 0, flips = 0;
  std::uint64_t stream = 0;
  for (const NamedCamera& lens : EveryLens(48)) {
    Draws draws(4, stream++);
    const Pose pose = RandomPose(&draws);
    const auto g = GaussiansInView(lens.camera, pose, 130, kKind, &draws);  // no whole vectors
    const Pose end = ExpPose(0.02 * Eigen::Matrix<double, 6, 1>::Ones()) * pose;
    ExpectReference(lens, g, CameraMotion(pose), &pixels, &flips);
    ExpectReference(lens, g, CameraMotion(pose, end, Shutter::Named("top_to_bottom")), &pixels,
                    &flips);
  }
  EXPECT_GE(stream, 20U);
  EXPECT_LT(static_cast<double>(flips), kFlipsAValue * static_cast<double>(pixels));
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

}  // namespace
}  // namespace gsut
