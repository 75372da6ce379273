// The kernels of the order along each pixel's ray, compiled once per instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/raster/lines/ray_order.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "gsut/raster/lines/kernels.h"

#include "gsut/raster/lines/backward-inl.h"
#include "gsut/raster/lines/forward-inl.h"
#include "gsut/raster/pixels-inl.h"
#include "gsut/raster/ray_order-inl.h"
#include "gsut/raster/ray_order_backward-inl.h"
#include "gsut/raster/ray_order_keys-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Where a line is nearest to a Gaussian, p, lies inside its cut-off ellipsoid. With n the direction
// of the mean m (parallel: of the lines), C the cut-off and S the covariance,
//   n.p >= n.m - sqrt(C n'Sn):
// t, from where a line starts, is less by no more than FarthestOrigin.
void LineRayOrderKeys(const RasterTask& task, bool is_parallel, std::int64_t begin,
                      std::int64_t end, Frame* frame) {
  WriteKeys(task, begin, end, frame, [&](const SeenLanes& g) HWY_ATTR {
    Lane n[3] = {Lane(0.0), Lane(0.0), Lane(1.0)};
    for (int k = 0; k < 3 && !is_parallel; ++k) n[k] = g.mean[k] / g.distance;
    return Dot3(g.mean, n) - Sqrt(g.cutoff * Spread(g, n).variance);
  });
}

// How far from the reference (parallel: in front of it) the lines of a tile start at most.
float FarthestOrigin(const LineGrid& grid, int tile) {
  const float* bundle = grid.bundles[static_cast<std::size_t>(tile)].values;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  float farthest = std::numeric_limits<float>::lowest();
  for (std::size_t o = pixel0; o < pixel0 + kTilePixels; ++o) {
    if (!(grid.tiles.start[o] > 0.0f)) continue;
    const float x = grid.slide[o];
    const float e1 = grid.a[o] + x * grid.tiles.s[o], e2 = grid.b[o] + x * grid.tiles.t[o];
    const float ahead = e1 * bundle[LineBundle::kD + 5] + e2 * bundle[LineBundle::kD + 8] +
                        x * bundle[LineBundle::kD + 2];
    const float away = std::sqrt(e1 * e1 + e2 * e2 + x * x);
    farthest = std::max(farthest, grid.is_parallel ? ahead : away);
  }
  return farthest;
}

template <class Notes>
HWY_NOINLINE void BlendLinesAlongRays(const RasterTask& task, const LineGrid& grid, int tile,
                                      Frame* frame, Notes* notes) {
  WithLineKernel(task, grid, tile, *frame, [&](auto& kernel) HWY_ATTR {
    BlendTileAlongRays(task, grid.tiles, tile, FarthestOrigin(grid, tile), kernel, frame, notes);
  });
}

void LineRayOrderForward(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                         float* image, float* alpha, float* depth, float* distortion) {
  NoNotes notes;
  BlendLinesAlongRays(task, grid, tile, frame, &notes);
  WritePixels(grid.tiles, tile, *frame, task.background, task.with_depth, image, alpha, depth,
              distortion);
}

void LineRayOrderBackward(const RasterTask& task, const LineGrid& grid, int tile,
                          const ImageGradients& gradients, Frame* frame, float* to_lines) {
  HWY_ALIGN float buffer[7 * kTilePixels];
  const PixelGradients pixels =
      ReadPixelGradients(grid.tiles, tile, gradients, task.background, buffer);
  const auto blend = [&](RayNotes<kNumLineFields>* notes)
                         HWY_ATTR { BlendLinesAlongRays(task, grid, tile, frame, notes); };
  const bool with_error = gradients.error != nullptr;
  BackwardLines({gradients.HasDepth(), to_lines != nullptr, with_error}, task, grid, tile,
                RayPairs(task, *frame, tile, blend), pixels, frame, to_lines);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(LineRayOrderKeys);
HWY_EXPORT(LineRayOrderForward);
HWY_EXPORT(LineRayOrderBackward);

void LineRayOrderKeysKernel(const RasterTask& task, bool is_parallel, std::int64_t begin,
                            std::int64_t end, Frame* frame) {
  HWY_DYNAMIC_DISPATCH(LineRayOrderKeys)(task, is_parallel, begin, end, frame);
}

void LineRayOrderForwardKernel(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                               float* image, float* alpha, float* depth, float* distortion) {
  HWY_DYNAMIC_DISPATCH(LineRayOrderForward)
  (task, grid, tile, frame, image, alpha, depth, distortion);
}

void LineRayOrderBackwardKernel(const RasterTask& task, const LineGrid& grid, int tile,
                                const ImageGradients& gradients, Frame* frame, float* to_lines) {
  HWY_DYNAMIC_DISPATCH(LineRayOrderBackward)(task, grid, tile, gradients, frame, to_lines);
}

}  // namespace gsut
#endif
