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

}  // namespace gsut
