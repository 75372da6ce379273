// The kernels of the order along each pixel's ray for rays from one point, compiled once per
// instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/raster/central/ray_order.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/raster/central/kernels.h"

#include "gsut/raster/central/backward-inl.h"
#include "gsut/raster/central/forward-inl.h"
#include "gsut/raster/pixels-inl.h"
#include "gsut/raster/ray_order-inl.h"
#include "gsut/raster/ray_order_backward-inl.h"
#include "gsut/raster/ray_order_keys-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Where a ray is nearest to a Gaussian, p, lies on the ellipsoid p'S^-1 (p - m) = 0 with the mean m
// as a diameter. Within the cut-off C, (p - m)'S^-1 (p - m) < C, with n the direction of m,
//   n.p >= |m| - C / (|m| n'S^-1 n) - sqrt(C (n'Sn - 1 / n'S^-1 n)),
// and t = |p| is no less: for a sphere only a sagitta is taken from |m|.
void RayOrderKeys(const RasterTask& task, std::int64_t begin, std::int64_t end, Frame* frame) {
  constexpr double kRounding = 1e-6;  // of the difference below, relative to n'Sn
  WriteKeys(task, begin, end, frame, [](const SeenLanes& g) HWY_ATTR {
    const Lane n[3] = {g.mean[0] / g.distance, g.mean[1] / g.distance, g.mean[2] / g.distance};
    const Spread spread(g, n);
    const Lane across =
        Max(spread.variance - spread.least, Lane(0.0)) + Lane(kRounding) * spread.variance;
    return g.distance - g.cutoff * spread.least / g.distance - Sqrt(g.cutoff * across);
  });
}

// Chunks that are read before hits are swept: most hits wait for as many Gaussians in long lists,
// and waiting costs little.
inline constexpr int kPartsAlongRays = 4;

void RayOrderForward(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                     float* image, float* alpha, float* depth, float* distortion) {
  CentralChunks<kPartsAlongRays> kernel(task, grid, tile, *frame);
  NoNotes notes;
  BlendTileAlongRays(task, grid, tile, 0.0f, kernel, frame, &notes);
  WritePixels(grid, tile, *frame, task.background, task.with_depth, image, alpha, depth,
              distortion);
}

// Blends once more to note each Gaussian's light and worth at each block; compiled once for all
// flags.
HWY_NOINLINE void NoteTileAlongRays(const RasterTask& task, const TileGrid& grid, int tile,
                                    Frame* frame, RayNotes<kNumRayFields>* notes) {
  CentralChunks<kPartsAlongRays> kernel(task, grid, tile, *frame);
  BlendTileAlongRays(task, grid, tile, 0.0f, kernel, frame, notes);
}

void RayOrderBackward(const RasterTask& task, const TileGrid& grid, int tile,
                      const ImageGradients& gradients, Frame* frame, float* to_rays) {
  HWY_ALIGN float buffer[7 * kTilePixels];
  const PixelGradients pixels = ReadPixelGradients(grid, tile, gradients, task.background, buffer);
  const auto blend = [&](RayNotes<kNumRayFields>* notes)
                         HWY_ATTR { NoteTileAlongRays(task, grid, tile, frame, notes); };
  WithBackwardFlags(gradients, to_rays != nullptr, [&](BackwardFlags flags) GSUT_INLINED_LAMBDA {
    BackwardTile(flags, task, grid, tile, RayPairs(task, *frame, tile, blend), pixels, frame,
                 to_rays);
  });
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(RayOrderKeys);
HWY_EXPORT(RayOrderForward);
HWY_EXPORT(RayOrderBackward);

void RayOrderKeysKernel(const RasterTask& task, std::int64_t begin, std::int64_t end,
                        Frame* frame) {
  HWY_DYNAMIC_DISPATCH(RayOrderKeys)(task, begin, end, frame);
}

void RayOrderForwardKernel(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                           float* image, float* alpha, float* depth, float* distortion) {
  HWY_DYNAMIC_DISPATCH(RayOrderForward)
  (task, grid, tile, frame, image, alpha, depth, distortion);
}

void RayOrderBackwardKernel(const RasterTask& task, const TileGrid& grid, int tile,
                            const ImageGradients& gradients, Frame* frame, float* to_rays) {
  HWY_DYNAMIC_DISPATCH(RayOrderBackward)(task, grid, tile, gradients, frame, to_rays);
}

}  // namespace gsut
#endif
