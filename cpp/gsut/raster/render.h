// The tiled float renderer: project, bin, blend. Its backward stands in render_backward.cpp.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "gsut/base/stopwatch.h"
#include "gsut/cameras/camera.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/geometry/shutter.h"
#include "gsut/projection/project.h"
#include "gsut/raster/blend_rule.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/line_grid.h"
#include "gsut/raster/surface_maps.h"
#include "gsut/raster/task.h"
#include "gsut/raster/tile_grid.h"
#include "gsut/raster/view_rays.h"

namespace gsut {

struct WalkScene;

// One image to be rendered: the camera and its pose, the rules, and where the pixels go.
struct RenderJob {
  Camera camera;
  CameraMotion motion;
  RenderSettings settings = {};
  UnscentedOptions unscented = {};
  bool keep_for_backward = true;
  // (rows, columns) of 16 x 16 pixels, row-major: tiles that are 0 are left out. They show the
  // background and add nothing to any gradient; null: all are drawn. A byte a tile, not a bit a
  // block of pixels, so that what is left out is the same for every instruction set.
  const std::uint8_t* tiles = nullptr;
  // Values beside the colours; they force keep_for_backward.
  Channels<float> channels = {};
  // Whether also rays that start at one point take the kernels of lines.
  bool as_lines = false;
  // Outputs, row-major; all but the image may be null.
  float* image = nullptr;          // (H, W, 3)
  float* alpha = nullptr;          // (H, W)
  float* depth = nullptr;          // (H, W)
  float* distortion = nullptr;     // (H, W)
  float* channel_image = nullptr;  // (H, W, D), of `channels`

  // Whether distances are blended at all: what a later gradient to them needs.
  bool WithDepth() const { return depth != nullptr || distortion != nullptr || channels.count > 0; }
};

// Renders one camera after another with buffers that only grow. Not thread-safe; inside, all loops
// are parallel and give the same bits on any number of threads. Rays that start at one point (a
// central lens, standing still) have kernels of their own for Gaussians by their maximum in an
// order of centres; lines (a rolling shutter, a lens without one centre, and all else) have others.
// Error against the double reference: image rms at most 1e-5 (RENDER_IMAGE_RMS in
// tests/tolerances/raster.py).
class Renderer {
 public:
  // Writes the job's outputs. A Gaussian with a parameter that is not finite, or centred on the
  // camera, is not drawn. The arrays behind `gaussians` must live, unchanged, until the backward
  // call; the job's outputs and tiles need not.
  void Render(const GaussiansView<const float>& gaussians, const RenderJob& job);

  // Gradients of L = sum(dimage * image) + sum(dalpha * alpha) + sum(ddepth * depth) +
  // sum(ddistortion * distortion) + sum(dchannels * channel_image) for the last Render; depth and
  // distortion need RenderJob::WithDepth.
  // to.rows is shaped like the Gaussians and overwritten. With to.step, which must be of the
  // rendered harmonics and excludes write_untouched, the next Backward needs another Render.
  // dpose[12]: gradient to xi = (v, w) in camera_from_world <- ExpPose(xi)
  // camera_from_world of the start pose, then of the end pose ([6] for a global shutter); null if
  // not wanted, which saves time for lines. rays: gradients to the image's rays, across them, in
  // the frame of MakeViewRays' reference; their origins stay empty if all start at its centre; null
  // if not wanted, which saves time.
  void Backward(const ImageGradients& to_image, const GradientRows& to, double* dpose,
                RayGradients* rays = nullptr);

  // The last render's rays, world axes: unit directions (H, W, 3), 0 where a pixel has none, and
  // origins (H, W, 3) less the centre of the rays' reference.
  void Rays(float* directions, float* origins) const;

  // Derivatives of the colours of pixels (row-major indices) of the last Render, which was made
  // with keep_for_backward through a lens with one centre and a global shutter: by_center (count,
  // 3, 3), colour by the camera's centre, world axes, the change of shading included; by_ray
  // (count, 3, 3), colour by the pixel's unit ray, across it, camera axes. Forward mode, exact as
  // Backward is. A pixel without a ray has zeros.
  void Jacobian(std::span<const std::uint32_t> pixels, double* by_center, double* by_ray);
  // What the last kept render's pixels see of each Gaussian, in double along the same rays; chosen
  // (H, W): pixels with 0 are left out, null: all with a ray. The same bits on any threads.
  // significance (N) grows by the sum over the pixels that draw it of opacity x transmittance in
  // front of it. winner (H, W): the Gaussian with the largest blend weight, -1 where there is none;
  // point (H, W, 3): where the ray is nearest to that Gaussian's centre, world axes; else 0.
  void AddSignificance(const std::uint8_t* chosen, double* significance, std::int32_t* winner,
                       float* point) const;
  // fisher (N, 21) grows by the sum over pixels and channels of J J^T, its upper triangle row by
  // row; J: derivative of the channel to the mean (world axes) and to the three scales (world
  // units), in this order.
  static constexpr int kFisherSums = 21;
  void AddFisher(const std::uint8_t* chosen, double* fisher) const;
  // photograph (H, W, 3); support (N, 2) grows by how much the squared difference between image and
  // photograph, summed over pixels and channels, would grow without the Gaussian (below 0: it does
  // harm), and by the sum of its blend weights.
  static constexpr int kSupportSums = 2;
  void AddSupport(const float* photograph, const std::uint8_t* chosen, double* support) const;

  // map (H, W, count): values of the pixels of the last kept render. sums (N, count) grows by the
  // sum over pixels of blend weight x value: divided by that of a map of ones, the values that the
  // Gaussians would show. The same bits on any threads.
  void AddFeatures(const float* map, int count, float* sums);

  // Where the surface lies along the rays of the last kept render, see SurfaceMaps; as the scores,
  // in double along the same rays.
  void Surface(const SurfaceMaps& maps) const;
  // Adds the gradients of L = sum(dnormals * normals) to those of means, quats, log_scales and
  // opacity_logits; `gradients` is shaped like the Gaussians.
  void SurfaceBackward(const float* dnormals, const GaussiansView<float>& gradients) const;

  // Times of the last calls' stages, in order: "project", "records", "bin", "forward", "backward",
  // "gradients".
  const std::vector<StageTime>& timings() const { return timings_; }

  const Splats& splats() const { return splats_; }
  const Frame& frame() const { return frame_; }
  // (tile, Gaussian) pairs listed, and of these the ones that touched a pixel (kept renders only).
  std::int64_t num_pairs() const { return static_cast<std::int64_t>(frame_.num_pairs()); }
  std::int64_t num_contributing_pairs() const;
  // Bytes of the buffers that are kept from frame to frame (not of the camera's rays and tiles).
  std::int64_t buffer_bytes() const;

 private:
  void FillTask(const GaussiansView<const float>& gaussians, const RenderJob& job);
  void ResizeFrame(const std::uint8_t* chosen);
  const TileGrid& tiles() const { return lines_ == nullptr ? *grid_ : lines_->tiles; }
  // The tile that is drawn as number `index`: in strips from top to bottom, so that what a tile
  // shares with the ones around it is still in a cache.
  int TileInOrder(std::int64_t index) const {
    constexpr int kStrip = 8;
    const TileGrid& grid = tiles();
    const int x0 = static_cast<int>(index / (kStrip * grid.tiles_y)) * kStrip;
    const int width = std::min(kStrip, grid.tiles_x - x0);
    const int within = static_cast<int>(index) - x0 * grid.tiles_y;
    return within / width * grid.tiles_x + x0 + within % width;
  }
  // Throws InputError unless the last render kept what another pass reads: of its order, or
  // `without`.
  void CheckKept(bool kept, const char* without) const;
  WalkScene LastScene() const;
  // Renders the last image once more, by the kernels of lines.
  void RenderAsLines();
  void CheckBackward(const ImageGradients& to_image, const GradientRows& to, bool is_plain) const;
  void CheckStep(const GradientRows& to) const;
  // Stage 1 of Backward: gradients of one tile's pairs into their slots, of its rays into `rays`
  // unless null, and of its pairs' channels into to_channels unless null.
  void BackwardOfTile(int tile, const ImageGradients& to_image, RayGradients* rays,
                      float* to_channels);
  // From the kernels' gradients to a tile's lines (or rays) to those of its pixels' rays.
  void ToRays(int tile, const float* to_lines, const ImageGradients& to_image,
              RayGradients* rays) const;

  std::vector<StageTime> timings_;
  RasterTask task_;
  std::shared_ptr<const TileGrid> grid_;
  std::shared_ptr<const LineGrid> lines_;  // null: rays from one point, `grid_` is used
  std::unique_ptr<Camera> camera_;         // of the last render, and how it moved
  CameraMotion motion_;
  AlignedVector<float> shading_slopes_;  // of Jacobian
  Pose reference_;  // camera_from_world of the rays' reference, and the rule, of the last render
  BlendRule rule_;
  double background_[3] = {0, 0, 0};
  Splats splats_;
  Frame frame_;
  bool rendered_ = false, stepped_ = false;
  bool along_rays_ = false;  // rendered for the backward pass in the order of each ray
};

}  // namespace gsut
