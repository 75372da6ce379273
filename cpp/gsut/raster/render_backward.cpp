// The backward pass of a frame: tiles to slots, slots to Gaussians, Gaussians to the pose.
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/raster/central/kernels.h"
#include "gsut/raster/render.h"

namespace gsut {
namespace {

constexpr std::int64_t kGaussianGrain = 2048;

}  // namespace

void Renderer::Backward(const float* dimage, const float* dalpha, const float* ddepth,
                        bool write_untouched, const GaussiansView<float>& gradients,
                        std::uint8_t* touched, double* dpose, RayGradients* rays) {
  if (!rendered_) {
    throw InputError("backward needs a render before it, made with keep_for_backward");
  }
  if (ddepth != nullptr && !task_.with_depth) {
    throw InputError("a gradient to depth needs a render with_depth");
  }
  if (gradients.size != task_.gaussians.size ||
      gradients.sh_coefficients != task_.gaussians.sh_coefficients) {
    throw InputError("gradients must be shaped like the rendered Gaussians");
  }
  const std::size_t slots = frame_.pairs.size();
  frame_.slot_gradients.resize(slots * 16);
  frame_.slot_touched.resize(slots);
  std::fill(frame_.slot_touched.begin(), frame_.slot_touched.end(), std::uint8_t{0});
  const ImageGradients image_gradients = {dimage, dalpha, ddepth};
  if (lines_ != nullptr) {
    BackwardLines(image_gradients, write_untouched, gradients, touched, dpose, rays);
    return;
  }
  Stopwatch watch;
  if (rays != nullptr) {
    rays->origins.clear();
    rays->rays.assign(3 * static_cast<std::size_t>(grid_->width) * grid_->height, 0.0);
  }
  ParallelFor(grid_->num_tiles(), 1, [&](std::int64_t tile, std::int64_t) {
    alignas(64) float to_rays[2 * kTilePixels];
    BackwardKernel(task_, *grid_, static_cast<int>(tile), image_gradients, &frame_,
                   rays == nullptr ? nullptr : to_rays);
    if (rays != nullptr) ToCentralRays(static_cast<int>(tile), to_rays, ddepth, rays);
  });
  timings_.push_back(watch.Lap("backward"));
  const std::int64_t chunks = (gradients.size + kGaussianGrain - 1) / kGaussianGrain;
  std::vector<std::array<double, 6>> pose(static_cast<std::size_t>(chunks));
  ParallelFor(gradients.size, kGaussianGrain, [&](std::int64_t begin, std::int64_t end) {
    std::array<double, 6>& sum = pose[static_cast<std::size_t>(begin / kGaussianGrain)];
    sum.fill(0.0);
    GradientsKernel(task_, frame_, begin, end, write_untouched, gradients, touched, sum.data());
  });
  timings_.push_back(watch.Lap("gradients"));
  if (dpose == nullptr) return;
  std::fill_n(dpose, 6, 0.0);
  for (const std::array<double, 6>& sum : pose) {
    for (int k = 0; k < 6; ++k) dpose[k] += sum[static_cast<std::size_t>(k)];
  }
}

void Renderer::ToCentralRays(int tile, const float* to_rays, const float* ddepth,
                             RayGradients* rays) const {
  const RayBundle& bundle = grid_->bundles[static_cast<std::size_t>(tile)];
  const auto axis = [&](int k) {
    return Eigen::Vector3d(
        Eigen::Map<const Eigen::Vector3f>(&bundle.values[RayBundle::kFrame + 3 * k])
            .cast<double>());
  };
  const Eigen::Vector3d d = axis(0), e1 = axis(1), e2 = axis(2);
  const int x0 = (tile % grid_->tiles_x) * kTileSize, y0 = (tile / grid_->tiles_x) * kTileSize;
  for (int y = y0; y < std::min(y0 + kTileSize, grid_->height); ++y) {
    for (int x = x0; x < std::min(x0 + kTileSize, grid_->width); ++x) {
      const int offset = grid_->PixelOffset(x - x0, y - y0);
      const std::size_t i =
          static_cast<std::size_t>(tile) * kTilePixels + static_cast<std::size_t>(offset);
      if (grid_->start[i] == 0.0f) continue;
      const std::size_t pixel = static_cast<std::size_t>(y) * grid_->width + x;
      const double s = static_cast<double>(grid_->s[i]), t = static_cast<double>(grid_->t[i]);
      const double length = std::sqrt(1.0 + s * s + t * t);
      // Distances along the unit ray are those in units of D + s E1 + t E2 times its length.
      const double to_length = ddepth == nullptr ? 0.0
                                                 : static_cast<double>(ddepth[pixel]) *
                                                       static_cast<double>(frame_.depth[i]);
      const double to_s = static_cast<double>(to_rays[offset]) + to_length * s / length;
      const double to_t =
          static_cast<double>(to_rays[kTilePixels + offset]) + to_length * t / length;
      // s = d.E1 / d.D and t = d.E2 / d.D for the unit ray d, where 1 / d.D is the length.
      Eigen::Map<Eigen::Vector3d>(&rays->rays[3 * pixel]) =
          length * (to_s * (e1 - s * d) + to_t * (e2 - t * d));
    }
  }
}

}  // namespace gsut
