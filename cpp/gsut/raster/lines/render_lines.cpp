// Frames of lines, forward and backward: rolling shutters and lenses without one centre.
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/projection/project_kernels.h"
#include "gsut/raster/bin_tiles.h"
#include "gsut/raster/lines/kernels.h"
#include "gsut/raster/render.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;

constexpr std::int64_t kGaussianGrain = 2048;
// Gradients to a, b, s, t and slide of a tile's lines.
constexpr std::size_t kLineGradients = 5 * kTilePixels;

}  // namespace

void Renderer::RenderLines(float* image, float* alpha, float* depth) {
  Stopwatch watch;
  lines_ = LinesOf(*camera_, motion_, ActiveLanes());
  const TileGrid& tiles = lines_->tiles;
  if (lines_->too_wide) {
    throw InputError(
        "the image is too small for its field of view: the rays of a tile of 16 x 16 pixels spread "
        "over more than 168 degrees; render a larger image or use dtype=\"float64\"");
  }
  timings_.push_back(watch.Lap("project"));
  ResizeFrame(tiles);
  splats_.Resize(task_.gaussians.size);
  ParallelFor(task_.gaussians.size, kRecordsPart, [&](std::int64_t begin, std::int64_t end) {
    frame_.row_spans[static_cast<std::size_t>(begin / kRecordsPart)].clear();
    LineRecordsKernel(task_, *lines_, begin, end, &frame_, &splats_);
  });
  timings_.push_back(watch.Lap("records"));
  BinTiles(tiles, &frame_);
  timings_.push_back(watch.Lap("bin"));
  ResizePairs(tiles);
  ParallelFor(tiles.num_tiles(), 1, [&](std::int64_t tile, std::int64_t) {
    LineForwardKernel(task_, *lines_, static_cast<int>(tile), &frame_, image, alpha, depth);
  });
  timings_.push_back(watch.Lap("forward"));
  rendered_ = task_.keep;
}

void Renderer::BackwardLines(const ImageGradients& image_gradients, bool write_untouched,
                             const GaussiansView<float>& gradients, std::uint8_t* touched,
                             double* dpose, RayGradients* rays) {
  Stopwatch watch;
  const TileGrid& tiles = lines_->tiles;
  RayGradients of_image;
  if (rays == nullptr) rays = &of_image;
  const bool with_rays = dpose != nullptr || rays != &of_image;
  if (with_rays) {
    const std::size_t pixels = static_cast<std::size_t>(tiles.width) * tiles.height;
    rays->origins.assign(3 * pixels, 0.0);
    rays->rays.assign(3 * pixels, 0.0);
  }
  ParallelFor(tiles.num_tiles(), 1, [&](std::int64_t tile, std::int64_t) {
    alignas(64) float to_lines[kLineGradients];
    LineBackwardKernel(task_, *lines_, static_cast<int>(tile), image_gradients, &frame_,
                       with_rays ? to_lines : nullptr);
    if (with_rays) ToRays(static_cast<int>(tile), to_lines, image_gradients.depth, rays);
  });
  timings_.push_back(watch.Lap("backward"));
  const std::int64_t chunks = (gradients.size + kGaussianGrain - 1) / kGaussianGrain;
  std::vector<std::array<double, 6>> parts(static_cast<std::size_t>(chunks));
  ParallelFor(gradients.size, kGaussianGrain, [&](std::int64_t begin, std::int64_t end) {
    std::array<double, 6>& sum = parts[static_cast<std::size_t>(begin / kGaussianGrain)];
    sum.fill(0.0);
    LineGradientsKernel(task_, lines_->is_parallel, frame_, begin, end, write_untouched, gradients,
                        touched, sum.data());
  });
  timings_.push_back(watch.Lap("gradients"));
  if (dpose == nullptr) return;
  ShadingGradient shading;
  for (const std::array<double, 6>& sum : parts) {
    shading.center += Map<const Vector3d>(sum.data());
    shading.axis += Map<const Vector3d>(sum.data() + 3);
  }
  ChainToPoses(MakeViewRays(*camera_, motion_), *camera_, motion_, *rays, shading, dpose);
  timings_.push_back(watch.Lap("poses"));
}

void Renderer::ToRays(int tile, const float* to_lines, const float* ddepth,
                      RayGradients* rays) const {
  const TileGrid& tiles = lines_->tiles;
  const float* bundle = lines_->bundles[static_cast<std::size_t>(tile)].values;
  Vector3d axes[3];
  for (int k = 0; k < 3; ++k) {
    axes[k] = Map<const Eigen::Vector3f>(bundle + LineBundle::kD + 3 * k).cast<double>();
  }
  const auto& [d, e1, e2] = axes;
  const int x0 = (tile % tiles.tiles_x) * kTileSize, y0 = (tile / tiles.tiles_x) * kTileSize;
  for (int y = y0; y < std::min(y0 + kTileSize, tiles.height); ++y) {
    for (int x = x0; x < std::min(x0 + kTileSize, tiles.width); ++x) {
      const int offset = tiles.PixelOffset(x - x0, y - y0);
      const std::size_t i =
          static_cast<std::size_t>(tile) * kTilePixels + static_cast<std::size_t>(offset);
      if (tiles.start[i] == 0.0f) continue;
      const auto to = [&](int k) {
        return static_cast<double>(to_lines[k * kTilePixels + offset]);
      };
      const double s = static_cast<double>(tiles.s[i]), t = static_cast<double>(tiles.t[i]);
      const double length = std::sqrt(1.0 + s * s + t * t);
      const double slide = static_cast<double>(lines_->slide[i]);
      const std::size_t pixel = static_cast<std::size_t>(y) * tiles.width + x;
      // The distance along the ray is (x - slide) times its length.
      const double to_length = ddepth == nullptr ? 0.0
                                                 : static_cast<double>(ddepth[pixel]) *
                                                       static_cast<double>(frame_.depth[i]);
      // a = o.E1 - slide s, b = o.E2 - slide t, slide = o.D for the origin o; s = d.E1 / d.D and
      // t = d.E2 / d.D for the direction d, where 1 / d.D is the length.
      const double to_s = to(2) - slide * to(0) + to_length * s / length;
      const double to_t = to(3) - slide * to(1) + to_length * t / length;
      const double to_slide = to(4) - s * to(0) - t * to(1);
      Map<Vector3d>(&rays->origins[3 * pixel]) = to(0) * e1 + to(1) * e2 + to_slide * d;
      Map<Vector3d>(&rays->rays[3 * pixel]) = length * (to_s * (e1 - s * d) + to_t * (e2 - t * d));
    }
  }
}

}  // namespace gsut
