// The calls into the vectorised kernels that blend Gaussians in the order of each pixel's own ray.
#pragma once

#include <cstdint>

#include "gsut/raster/frame.h"
#include "gsut/raster/line_grid.h"
#include "gsut/raster/task.h"
#include "gsut/raster/tile_grid.h"

namespace gsut {

// Where the rays of an image start: at one point, at places of their own, or, all along one
// direction, on a plane.
enum class RayOrigins { kOne, kMany, kParallel };

// Order keys of the Gaussians [begin, end), begin a multiple of 16, after their records: instead of
// a mean's distance (parallel: z) the least at which any ray may be nearest to the Gaussian.
void RayOrderKeysKernel(const RasterTask& task, RayOrigins origins, std::int64_t begin,
                        std::int64_t end, Frame* frame);

// As ForwardKernel and LineForwardKernel, of lists by those keys; leaves no entries. Each pixel
// blends in the order of its own ray, ties in the order of the list.
void RayOrderForwardKernel(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                           float* image, float* alpha, float* depth, float* distortion);
void RayOrderLineForwardKernel(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                               float* image, float* alpha, float* depth, float* distortion);

}  // namespace gsut
