// The backward pass of a frame: tiles to slots, slots to Gaussians, Gaussians to the pose.
#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/check_gaussians.h"
#include "gsut/raster/central/kernels.h"
#include "gsut/raster/lines/kernels.h"
#include "gsut/raster/render.h"
#include "gsut/raster/scores/add_over_tiles.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;

constexpr std::int64_t kGaussianGrain = 2048;
// Gradients to a, b, s, t and slide of a tile's lines; to s and t only where they start at a point.
constexpr std::size_t kLineGradients = 5;

}  // namespace

void Renderer::Backward(const ImageGradients& to_image, const GradientRows& to, double* dpose,
                        RayGradients* rays) {
  CheckBackward(to_image, to, !to_image.HasDepth() && dpose == nullptr && rays == nullptr);
  if (to.step != nullptr) stepped_ = true;  // what was rendered changes
  // Stage 1, tiles to slots: each (tile, Gaussian) pair has a slot of its own, so that tiles need
  // neither locks nor atomic sums, whose order would change with the threads.
  const std::size_t slots = frame_.pairs.size();
  frame_.slot_gradients.resize(slots * 16);
  frame_.slot_touched.resize(slots);
  std::fill(frame_.slot_touched.begin(), frame_.slot_touched.end(), std::uint8_t{0});
  Stopwatch watch;
  // The gradient to the poses of lines comes through their rays.
  RayGradients of_image;
  const bool with_rays = rays != nullptr || (lines_ != nullptr && dpose != nullptr);
  if (rays == nullptr) rays = &of_image;
  const std::size_t pixels = static_cast<std::size_t>(tiles().width) * tiles().height;
  rays->origins.assign(with_rays && lines_ != nullptr ? 3 * pixels : 0, 0.0);
  rays->rays.assign(with_rays ? 3 * pixels : 0, 0.0);
  RayGradients* const to_rays = with_rays ? rays : nullptr;
  if (to_image.channels == nullptr) {
    ParallelFor(tiles().num_tiles(), 1, [&](std::int64_t index, std::int64_t) {
      BackwardOfTile(TileInOrder(index), to_image, to_rays, nullptr);
    });
  } else {
    // The gradients to channels have no slots, which would be D floats a pair: tiles take turns.
    const auto values = static_cast<std::size_t>(task_.channels.count * task_.gaussians.size);
    std::fill_n(to.channels, values, 0.0f);
    AddOverTiles(
        frame_, tiles().num_tiles(), task_.channels.count,
        [&](int tile, float* sums) { BackwardOfTile(tile, to_image, to_rays, sums); }, to.channels);
  }
  timings_.push_back(watch.Lap("backward"));
  // Stage 2, slots to Gaussians: the slots of a Gaussian are added in the order of its tiles; its
  // parameters' gradients follow from the sums alone. What the pose gets is added up by chunk.
  const std::int64_t chunks = (to.rows.size + kGaussianGrain - 1) / kGaussianGrain;
  std::vector<Vector6d> parts(static_cast<std::size_t>(chunks), Vector6d::Zero());
  ParallelFor(to.rows.size, kGaussianGrain, [&](std::int64_t begin, std::int64_t end) {
    double* sum = parts[static_cast<std::size_t>(begin / kGaussianGrain)].data();
    if (lines_ == nullptr) {
      GradientsKernel(task_, frame_, begin, end, to, dpose == nullptr ? nullptr : sum);
    } else {
      LineGradientsKernel(task_, lines_->is_parallel, frame_, begin, end, to, sum);
    }
  });
  timings_.push_back(watch.Lap("gradients"));
  // Stage 3, to the poses: seen from one centre, moving the camera is moving all Gaussians the
  // other way, and the sum is complete. Lines have poses of their own, reached through their rays;
  // here the sum holds only how the colours change with the direction of view.
  if (dpose == nullptr) return;
  Vector6d total = Vector6d::Zero();
  for (const Vector6d& part : parts) total += part;
  if (lines_ == nullptr) {
    std::copy_n(total.data(), 6, dpose);
    return;
  }
  ChainToPoses(MakeViewRays(*camera_, motion_), *camera_, motion_, *rays,
               {total.head<3>(), total.tail<3>()}, dpose);
  timings_.push_back(watch.Lap("poses"));
}

void Renderer::BackwardOfTile(int tile, const ImageGradients& to_image, RayGradients* rays,
                              float* to_channels) {
  alignas(64) float buffer[kLineGradients * kTilePixels];
  float* const to_rays = rays == nullptr ? nullptr : buffer;
  if (to_channels != nullptr) {
    LineChannelsBackwardKernel(task_, *lines_, tile, to_image, &frame_, to_rays, to_channels);
  } else if (along_rays_) {
    LineRayOrderBackwardKernel(task_, *lines_, tile, to_image, &frame_, to_rays);
  } else if (lines_ == nullptr) {
    BackwardKernel(task_, *grid_, tile, to_image, &frame_, to_rays);
  } else {
    LineBackwardKernel(task_, *lines_, tile, to_image, &frame_, to_rays);
  }
  if (rays != nullptr) ToRays(tile, buffer, to_image, rays);
}

void Renderer::AddFeatures(const float* map, int count, float* sums) {
  CheckKept(rendered_ && !stepped_,
            "features are lifted after a render, made with keep_for_backward");
  CheckGiven(map, "map");
  if (count < 1) throw InputError("a map has at least one value a pixel");
  CheckArray(sums, task_.gaussians.size, "sums");
  if (lines_ == nullptr) RenderAsLines();
  AddOverTiles(
      frame_, tiles().num_tiles(), count,
      [&](int tile, float* out) { LineLiftKernel(task_, *lines_, tile, map, count, &frame_, out); },
      sums);
}

// Blend weights are lifted by the kernels of lines alone: what was rendered along rays from one
// point is rendered once more. Its backward pass is then that of lines.
void Renderer::RenderAsLines() {
  RenderJob job = {*camera_, motion_};
  job.settings.rule = rule_;
  std::copy_n(background_, 3, job.settings.background);
  job.settings.sh_degree = task_.sh_degree;
  std::vector<std::uint8_t> chosen;
  for (const std::uint64_t blocks : frame_.alive) chosen.push_back(blocks != 0 ? 1 : 0);
  job.tiles = chosen.data();
  const std::size_t pixels = static_cast<std::size_t>(tiles().width) * tiles().height;
  std::vector<float> image(3 * pixels), depth(task_.with_depth ? pixels : 0);
  job.image = image.data();
  if (task_.with_depth) job.depth = depth.data();
  job.as_lines = true;
  const GaussiansView<const float> gaussians = task_.gaussians;
  Render(gaussians, job);
}

// is_plain: gradients neither of depth nor to poses nor to a lens.
void Renderer::CheckBackward(const ImageGradients& to_image, const GradientRows& to,
                             bool is_plain) const {
  CheckKept((rendered_ || along_rays_) && !stepped_,
            "backward needs a render before it, made with keep_for_backward");
  CheckGiven(to_image.image, "gradient to the image");
  if (to_image.HasDepth() && !task_.with_depth) {
    throw InputError("a gradient to depth or distortion needs a render with_depth");
  }
  CheckGradients(to.rows, task_.gaussians);
  CheckArray(to.touched, to.rows.size, "touched");
  if ((to_image.error != nullptr) != (to.error_sums != nullptr) ||
      (to_image.error != nullptr && (!is_plain || to_image.channels != nullptr))) {
    throw InputError(
        "sums of errors need the pixels' errors, and a backward pass without depth, channels, "
        "poses and lens");
  }
  if ((to_image.channels != nullptr) != (to.channels != nullptr) ||
      (to_image.channels != nullptr && task_.channels.count == 0)) {
    throw InputError("gradients of channels need a render with channels, and where to put them");
  }
  if (to.step != nullptr) CheckStep(to);
}

void Renderer::CheckStep(const GradientRows& to) const {
  if (to.step->params != task_.gaussians.sh || to.write_untouched ||
      to.step->active > 3 * task_.gaussians.sh_coefficients) {
    throw InputError(
        "harmonics can be stepped in the backward pass if they are the array that was rendered, "
        "and rows that no pixel saw stay as they are (write_untouched is false)");
  }
}

// From the gradients to a pixel's numbers in its tile's frame, s and t (of lines also a, b and
// slide), to those of its unit direction and its origin. Depth and distortion also depend on the
// direction's length in that frame, sqrt(1 + s^2 + t^2).
void Renderer::ToRays(int tile, const float* to_lines, const ImageGradients& to_image,
                      RayGradients* rays) const {
  const TileGrid& grid = tiles();
  const float* frame =
      lines_ == nullptr ? grid.bundles[static_cast<std::size_t>(tile)].values + RayBundle::kFrame
                        : lines_->bundles[static_cast<std::size_t>(tile)].values + LineBundle::kD;
  Vector3d axes[3];
  for (int k = 0; k < 3; ++k) axes[k] = Map<const Eigen::Vector3f>(frame + 3 * k).cast<double>();
  const auto& [d, e1, e2] = axes;
  const int x0 = (tile % grid.tiles_x) * kTileSize, y0 = (tile / grid.tiles_x) * kTileSize;
  for (int y = y0; y < std::min(y0 + kTileSize, grid.height); ++y) {
    for (int x = x0; x < std::min(x0 + kTileSize, grid.width); ++x) {
      const int offset = grid.PixelOffset(x - x0, y - y0);
      const std::size_t i =
          static_cast<std::size_t>(tile) * kTilePixels + static_cast<std::size_t>(offset);
      if (grid.start[i] == 0.0f) continue;
      const auto to = [&](int k) {
        return static_cast<double>(to_lines[k * kTilePixels + offset]);
      };
      const double s = static_cast<double>(grid.s[i]), t = static_cast<double>(grid.t[i]);
      const double length = std::sqrt(1.0 + s * s + t * t);
      const std::size_t pixel = static_cast<std::size_t>(y) * grid.width + x;
      // The distance along the unit ray is that in units of D + s E1 + t E2 (of lines: less the
      // slide) times its length, the distortion that times its square.
      double to_length = 0.0;
      if (to_image.depth != nullptr) {
        to_length =
            static_cast<double>(to_image.depth[pixel]) * static_cast<double>(frame_.depth[i]);
      }
      if (to_image.distortion != nullptr) {
        to_length += 2.0 * length * static_cast<double>(to_image.distortion[pixel]) *
                     frame_.Distortion(i, static_cast<double>(grid.start[i]));
      }
      double to_s = to_length * s / length, to_t = to_length * t / length;
      if (lines_ == nullptr) {
        to_s += to(0);
        to_t += to(1);
      } else {
        // a = o.E1 - slide s, b = o.E2 - slide t, slide = o.D for the origin o.
        const double slide = static_cast<double>(lines_->slide[i]);
        to_s += to(2) - slide * to(0);
        to_t += to(3) - slide * to(1);
        const double to_slide = to(4) - s * to(0) - t * to(1);
        Map<Vector3d>(&rays->origins[3 * pixel]) = to(0) * e1 + to(1) * e2 + to_slide * d;
      }
      // s = d.E1 / d.D and t = d.E2 / d.D for the unit ray d, where 1 / d.D is the length.
      Map<Vector3d>(&rays->rays[3 * pixel]) = length * (to_s * (e1 - s * d) + to_t * (e2 - t * d));
    }
  }
}

}  // namespace gsut
