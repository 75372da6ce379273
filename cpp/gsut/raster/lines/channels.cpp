// The kernels of channels beside the colour, compiled once per instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/raster/lines/channels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/raster/lines/kernels.h"

#include "gsut/raster/lines/forward-inl.h"
#include "gsut/raster/lines/backward-inl.h"
#include "gsut/raster/channels-inl.h"
#include "gsut/raster/channels_backward-inl.h"
#include "gsut/raster/pixels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// The tile's whole forward pass, colours included, whose weights blend all channels.
void LineChannelsForward(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                         float* image, float* alpha, float* depth, float* distortion,
                         float* channels) {
  LineKernel<LineKind::kEither> kernel(task, grid, tile, *frame);
  ForwardWithChannels(task, grid.tiles, tile, kernel, frame, channels);
  WritePixels(grid.tiles, tile, *frame, task.background, task.with_depth, image, alpha, depth,
              distortion);
}

// The tile's whole backward pass, colours included: what channels contribute to v_i joins what
// colours contribute before the gradient goes on to the response.
void LineChannelsBackward(const RasterTask& task, const LineGrid& grid, int tile,
                          const ImageGradients& gradients, Frame* frame, float* to_rays,
                          float* to_channels) {
  HWY_ALIGN float buffer[7 * kTilePixels];
  HWY_ALIGN float contribution[kTilePixels];
  PixelGradients pixels = ReadPixelGradients(grid.tiles, tile, gradients, task.background, buffer);
  TileChannels channels(task, grid.tiles, tile, gradients.channels, *frame, to_channels);
  channels.AddToPixels(static_cast<std::size_t>(tile) * kTilePixels, *frame,
                       buffer + 3 * kTilePixels, contribution);
  pixels.channels = contribution;
  BackwardLines({gradients.HasDepth(), to_rays != nullptr, false, true}, task, grid, tile,
                KeptPairs(*frame, tile), pixels, frame, to_rays, &channels);
}

void LineLift(const RasterTask& task, const LineGrid& grid, int tile, const float* map, int count,
              Frame* frame, float* out) {
  LineKernel<LineKind::kEither> kernel(task, grid, tile, *frame);
  LiftTile(task, grid.tiles, tile, kernel, map, count, frame, out);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(LineChannelsForward);
HWY_EXPORT(LineChannelsBackward);
HWY_EXPORT(LineLift);

void LineChannelsForwardKernel(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                               float* image, float* alpha, float* depth, float* distortion,
                               float* channels) {
  HWY_DYNAMIC_DISPATCH(LineChannelsForward)
  (task, grid, tile, frame, image, alpha, depth, distortion, channels);
}

void LineChannelsBackwardKernel(const RasterTask& task, const LineGrid& grid, int tile,
                                const ImageGradients& gradients, Frame* frame, float* to_rays,
                                float* to_channels) {
  HWY_DYNAMIC_DISPATCH(LineChannelsBackward)
  (task, grid, tile, gradients, frame, to_rays, to_channels);
}

void LineLiftKernel(const RasterTask& task, const LineGrid& grid, int tile, const float* map,
                    int count, Frame* frame, float* out) {
  HWY_DYNAMIC_DISPATCH(LineLift)(task, grid, tile, map, count, frame, out);
}

}  // namespace gsut
#endif
