// The backward pass of a frame: tiles to slots, slots to Gaussians, Gaussians to the pose.
#include <algorithm>
#include <array>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/raster/render.h"

namespace gsut {
namespace {

constexpr std::int64_t kGaussianGrain = 2048;

}  // namespace

void Renderer::Backward(const float* dimage, const float* dalpha, const float* ddepth,
                        bool write_untouched, const GaussiansView<float>& gradients,
                        std::uint8_t* touched, double* dpose) {
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
    BackwardLines(image_gradients, write_untouched, gradients, touched, dpose);
    return;
  }
  Stopwatch watch;
  ParallelFor(grid_->num_tiles(), 1, [&](std::int64_t tile, std::int64_t) {
    BackwardKernel(task_, *grid_, static_cast<int>(tile), image_gradients, &frame_);
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

}  // namespace gsut
