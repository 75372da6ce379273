// The kernels of channels beside the colour for rays from one point, compiled once per instruction
// set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/raster/central/channels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/raster/central/kernels.h"

#include "gsut/raster/central/forward-inl.h"
#include "gsut/raster/central/backward-inl.h"
#include "gsut/raster/channels-inl.h"
#include "gsut/raster/channels_backward-inl.h"
#include "gsut/raster/pixels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// The tile's whole forward pass, colours included, whose weights blend all channels.
void ChannelsForward(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                     float* image, float* alpha, float* depth, float* distortion, float* channels) {
  CentralChunk kernel(task, grid, tile, *frame);
  ForwardWithChannels(task, grid, tile, kernel, frame, channels);
  WritePixels(grid, tile, *frame, task.background, task.with_depth, image, alpha, depth,
              distortion);
}

// The tile's whole backward pass, colours included: what channels are worth joins what colours are
// worth before the gradient goes on to the response.
void ChannelsBackward(const RasterTask& task, const TileGrid& grid, int tile,
                      const ImageGradients& gradients, Frame* frame, float* to_rays,
                      float* to_channels) {
  BackwardWithChannels(task, grid, tile, gradients, to_rays != nullptr, *frame, to_channels,
                       [&](BackwardFlags flags, const PixelGradients& pixels,
                           TileChannels* channels) GSUT_INLINED_LAMBDA {
                         BackwardTile(flags, task, grid, tile, KeptPairs(*frame, tile), pixels,
                                      frame, to_rays, channels);
                       });
}

void Lift(const RasterTask& task, const TileGrid& grid, int tile, const float* map, int count,
          Frame* frame, float* out) {
  CentralChunk kernel(task, grid, tile, *frame);
  LiftTile(task, grid, tile, kernel, map, count, frame, out);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(ChannelsForward);
HWY_EXPORT(ChannelsBackward);
HWY_EXPORT(Lift);

void ChannelsForwardKernel(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                           float* image, float* alpha, float* depth, float* distortion,
                           float* channels) {
  HWY_DYNAMIC_DISPATCH(ChannelsForward)
  (task, grid, tile, frame, image, alpha, depth, distortion, channels);
}

void ChannelsBackwardKernel(const RasterTask& task, const TileGrid& grid, int tile,
                            const ImageGradients& gradients, Frame* frame, float* to_rays,
                            float* to_channels) {
  HWY_DYNAMIC_DISPATCH(ChannelsBackward)
  (task, grid, tile, gradients, frame, to_rays, to_channels);
}

void LiftKernel(const RasterTask& task, const TileGrid& grid, int tile, const float* map, int count,
                Frame* frame, float* out) {
  HWY_DYNAMIC_DISPATCH(Lift)(task, grid, tile, map, count, frame, out);
}

}  // namespace gsut
#endif
