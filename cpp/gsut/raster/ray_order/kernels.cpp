// The kernels of the order along each pixel's ray, compiled once per instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/raster/ray_order/kernels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <cmath>

#include "gsut/raster/ray_order/kernels.h"

#include "gsut/projection/seen-inl.h"
#include "gsut/raster/central/forward-inl.h"
#include "gsut/raster/lines/forward-inl.h"
#include "gsut/raster/pixels-inl.h"
#include "gsut/raster/ray_order/blend-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Where a ray is nearest to a Gaussian, p, lies inside its cut-off ellipsoid: n.p >= |m| - sqrt(C
// n'Sn), S the covariance, C the cut-off and n the direction of the mean m, so that t = |p| is no
// less. Rays from one point know more: p'S^-1 (p - m) = 0 puts p on the ellipsoid with m as a
// diameter, of whose points those within C reach no farther than
//   n.p >= |m| - C |m| / g^2 - sqrt(C (n'Sn - |m|^2 / g^2)), g^2 = m'S^-1 m:
// for a sphere only the sagitta is left.
void RayOrderKeys(const RasterTask& task, RayOrigins origins, std::int64_t begin, std::int64_t end,
                  Frame* frame) {
  constexpr double kRounding = 1e-5;          // of t, relative: a bound must not be above it
  constexpr double kVarianceRounding = 1e-6;  // of n'Sn, relative
  const FloatTag d;
  const bool is_parallel = origins == RayOrigins::kParallel;
  for (std::int64_t i = begin; i < end; i += kLanes) {
    const SeenLanes g = LoadSeen(task.gaussians, i, task.view, task.log2_raw_min, task.max_cutoff);
    Lane direction[3] = {Lane(0.0), Lane(0.0), Lane(1.0)};
    for (int k = 0; k < 3 && !is_parallel; ++k) direction[k] = g.mean[k] / g.distance;
    Lane variance(0.0), inverse_variance(0.0);  // along n, and of n in the inverse
    for (int k = 0; k < 3; ++k) {
      const Lane along = Dot3(g.axes[k], direction);
      const Lane scaled = g.scale[k] * along, whitened = along / g.scale[k];
      variance += scaled * scaled;
      inverse_variance += whitened * whitened;
    }
    const Lane at = is_parallel ? g.mean[2] : g.distance;
    Lane key = at - Lane(kRounding) * g.distance;
    if (origins == RayOrigins::kOne) {
      const Lane least = Lane(1.0) / inverse_variance;
      const Lane across = Max(variance - least, Lane(0.0)) + Lane(kVarianceRounding) * variance;
      key = key - g.cutoff * least / g.distance - Sqrt(g.cutoff * across);
    } else {
      key = key - Sqrt(g.cutoff * variance);
    }
    hn::StoreU(key.v, d, &frame->order_key[static_cast<std::size_t>(i)]);
  }
}

void RayOrderForward(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                     float* image, float* alpha, float* depth, float* distortion) {
  CentralChunk kernel(task, grid, tile, *frame);
  BlendTileAlongRays(task, grid, tile, 0.0f, kernel, frame);
  WritePixels(grid, tile, *frame, task.background, task.with_depth, image, alpha, depth,
              distortion);
}

// How far from the reference (parallel: before it) the tile's lines start at most, a bound for each
// of them.
float FarthestOrigin(const LineGrid& grid, int tile) {
  const float* bundle = grid.bundles[static_cast<std::size_t>(tile)].values;
  float farthest = 0.0f;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  for (std::size_t o = pixel0; o < pixel0 + kTilePixels; ++o) {
    if (!(grid.tiles.start[o] > 0.0f)) continue;
    const float x = grid.slide[o];
    const float e1 = grid.a[o] + x * grid.tiles.s[o], e2 = grid.b[o] + x * grid.tiles.t[o];
    const float z = e1 * bundle[LineBundle::kD + 5] + e2 * bundle[LineBundle::kD + 8] +
                    x * bundle[LineBundle::kD + 2];
    farthest = std::max(farthest, grid.is_parallel ? z : std::sqrt(e1 * e1 + e2 * e2 + x * x));
  }
  return farthest;
}

void RayOrderLineForward(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                         float* image, float* alpha, float* depth, float* distortion) {
  LineKernel kernel(task, grid, tile, *frame);
  BlendTileAlongRays(task, grid.tiles, tile, FarthestOrigin(grid, tile), kernel, frame);
  WritePixels(grid.tiles, tile, *frame, task.background, task.with_depth, image, alpha, depth,
              distortion);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(RayOrderKeys);
HWY_EXPORT(RayOrderForward);
HWY_EXPORT(RayOrderLineForward);

void RayOrderKeysKernel(const RasterTask& task, RayOrigins origins, std::int64_t begin,
                        std::int64_t end, Frame* frame) {
  HWY_DYNAMIC_DISPATCH(RayOrderKeys)(task, origins, begin, end, frame);
}

void RayOrderForwardKernel(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                           float* image, float* alpha, float* depth, float* distortion) {
  HWY_DYNAMIC_DISPATCH(RayOrderForward)
  (task, grid, tile, frame, image, alpha, depth, distortion);
}

void RayOrderLineForwardKernel(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                               float* image, float* alpha, float* depth, float* distortion) {
  HWY_DYNAMIC_DISPATCH(RayOrderLineForward)
  (task, grid, tile, frame, image, alpha, depth, distortion);
}

}  // namespace gsut
#endif
