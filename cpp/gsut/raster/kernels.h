// The calls into the vectorised raster kernels of the active instruction set.
#pragma once

#include <cstdint>

#include "gsut/gaussians/gaussians.h"
#include "gsut/gaussians/harmonics_rows.h"
#include "gsut/projection/project.h"
#include "gsut/projection/view.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/tile_grid.h"

namespace gsut {

// What the kernels need to know of one frame.
struct RasterTask {
  GaussiansView<const float> gaussians;
  HarmonicsRows sh_rows;  // of gaussians.sh
  ViewFloats view;
  float log2_alpha_min = 0;
  float max_cutoff = 0;
  float alpha_max = 0;
  float transmittance_min = 0;
  float background[3] = {0, 0, 0};
  float near_z = 0, far_z = 0;
  bool order_by_z = false;
  bool stop_before = false;
  bool with_depth = false;
  bool keep = false;  // leave what the backward pass needs
  int sh_degree = 0;
};

// Pixel gradients as the user gives them, row-major; alpha and depth may be null.
struct ImageGradients {
  const float* image;  // (H, W, 3)
  const float* alpha;  // (H, W)
  const float* depth;  // (H, W)
};

// Records, order keys and tile rectangles of the Gaussians [begin, end), begin a multiple of 16.
void RecordsKernel(const RasterTask& task, const TileGrid& grid, const Splats& splats,
                   std::int64_t begin, std::int64_t end, Frame* frame);

// Blends one tile and writes its pixels; image (H, W, 3), alpha (H, W), depth (H, W) or null.
void ForwardKernel(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                   float* image, float* alpha, float* depth);

// Gradients of one tile's pairs into their slots. to_rays: null, or 2 x 256 floats for the
// gradients to s and t of the tile's rays, swizzled.
void BackwardKernel(const RasterTask& task, const TileGrid& grid, int tile,
                    const ImageGradients& gradients, Frame* frame, float* to_rays);

// Gradients of the Gaussians [begin, end), begin a multiple of 16; adds the pose's to dpose[6].
void GradientsKernel(const RasterTask& task, const Frame& frame, std::int64_t begin,
                     std::int64_t end, bool write_untouched, const GaussiansView<float>& gradients,
                     std::uint8_t* touched, double* dpose);

}  // namespace gsut
