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
#include "gsut/raster/pixels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// After the tile's forward pass, whose list of contributing pairs it reads: their weights come out
// once more, with the same bits, and blend all channels.
void ChannelsForward(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                     float* image) {
  CentralChunk kernel(task, grid, tile, *frame);
  BlendChannels(task, grid, tile, kernel, frame);
  WriteChannels(task.channels, grid, tile, *frame, image);
}

// The tile's whole backward pass, colours included: what channels are worth joins what colours are
// worth before the gradient goes on to the response.
void ChannelsBackward(const RasterTask& task, const TileGrid& grid, int tile,
                      const ImageGradients& gradients, Frame* frame, float* to_rays,
                      float* to_channels) {
  BackwardWithChannels(task, grid, tile, gradients, *frame, to_channels,
                       [&](BackwardFlags flags, const PixelGradients& pixels,
                           TileChannels* channels) GSUT_INLINED_LAMBDA {
                         BackwardTile(flags, task, grid, tile, pixels, frame, to_rays, channels);
                       });
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(ChannelsForward);
HWY_EXPORT(ChannelsBackward);

void ChannelsForwardKernel(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                           float* image) {
  HWY_DYNAMIC_DISPATCH(ChannelsForward)(task, grid, tile, frame, image);
}

void ChannelsBackwardKernel(const RasterTask& task, const TileGrid& grid, int tile,
                            const ImageGradients& gradients, Frame* frame, float* to_rays,
                            float* to_channels) {
  HWY_DYNAMIC_DISPATCH(ChannelsBackward)
  (task, grid, tile, gradients, frame, to_rays, to_channels);
}

}  // namespace gsut
#endif
