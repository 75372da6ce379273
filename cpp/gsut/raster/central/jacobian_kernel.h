// The call into the vectorised derivatives of colours of the active instruction set.
#pragma once

#include <cstdint>

#include "gsut/raster/frame.h"
#include "gsut/raster/task.h"
#include "gsut/raster/tile_grid.h"

namespace gsut {

// Numbers of a line in its tile's frame: a E1 + b E2 + x (D + s E1 + t E2).
inline constexpr int kLineSlopes = 4;  // by a, b, s, t
// Derivatives of a Gaussian's three colours by the camera's centre, row by row.
inline constexpr int kShadingSlopes = 9;

// The kernel's output: kSize arrays of 256 floats per tile, swizzled.
struct TileSlopes {
  static constexpr int ByLine(int channel, int k) { return channel * kLineSlopes + k; }
  static constexpr int kShading = 3 * kLineSlopes;  // colours by the centre: what shading adds
  static constexpr int kSize = kShading + kShadingSlopes;
};

// Derivatives of one tile's colours. wanted: bit b for the blocks whose pixels are wanted; the
// others' are not complete. shading: 9 floats a Gaussian, or null where colours have no direction.
void JacobianKernel(const RasterTask& task, const TileGrid& grid, int tile, const Frame& frame,
                    const float* shading, std::uint64_t wanted, float* slopes);

}  // namespace gsut
