// The calls into the vectorised raster kernels of the active instruction set.
#pragma once

#include <cstdint>

#include "gsut/gaussians/gaussians.h"
#include "gsut/projection/project.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/task.h"
#include "gsut/raster/tile_grid.h"

namespace gsut {

// Records, order keys and tile rectangles of the Gaussians [begin, end), begin a multiple of 16.
void RecordsKernel(const RasterTask& task, const TileGrid& grid, const Splats& splats,
                   std::int64_t begin, std::int64_t end, Frame* frame);

// Blends one tile and writes its pixels; image (H, W, 3), alpha (H, W), depth (H, W) or null.
void ForwardKernel(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                   float* image, float* alpha, float* depth, float* distortion);

// Gradients of one tile's pairs into their slots. to_rays: null, or 2 x 256 floats for the
// gradients to s and t of the tile's rays, swizzled.
void BackwardKernel(const RasterTask& task, const TileGrid& grid, int tile,
                    const ImageGradients& gradients, Frame* frame, float* to_rays);

// Gradients of the Gaussians [begin, end), begin a multiple of 16; adds the pose's to dpose[6] if
// it is not null.
void GradientsKernel(const RasterTask& task, const Frame& frame, std::int64_t begin,
                     std::int64_t end, const GradientRows& to, double* dpose);

// As ForwardKernel, and blends task.channels into channels (H, W, D).
void ChannelsForwardKernel(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                           float* image, float* alpha, float* depth, float* distortion,
                           float* channels);

// As BackwardKernel with gradients to the channels' pixels. to_channels: those of the values of the
// tile's pairs, an entry a row of D.
void ChannelsBackwardKernel(const RasterTask& task, const TileGrid& grid, int tile,
                            const ImageGradients& gradients, Frame* frame, float* to_rays,
                            float* to_channels);

// Sums of blend weight x map (H, W, count) over the pixels of a kept tile: a row of `count` an
// entry.
void LiftKernel(const RasterTask& task, const TileGrid& grid, int tile, const float* map, int count,
                Frame* frame, float* out);

// For OrderKey::kRay, after RecordsKernel: order keys that bound where any ray is nearest to a
// Gaussian from below, for the Gaussians [begin, end), begin a multiple of 16.
void RayOrderKeysKernel(const RasterTask& task, std::int64_t begin, std::int64_t end, Frame* frame);

// As ForwardKernel, of lists by those keys: each pixel blends in the order of its own ray. Leaves
// no entries.
void RayOrderForwardKernel(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                           float* image, float* alpha, float* depth, float* distortion);

// As BackwardKernel, of a tile that RayOrderForwardKernel has blended.
void RayOrderBackwardKernel(const RasterTask& task, const TileGrid& grid, int tile,
                            const ImageGradients& gradients, Frame* frame, float* to_rays);

}  // namespace gsut
