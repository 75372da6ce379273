// Surfels (2DGS): Gaussians as thin as their kernels take for discs.
#pragma once

#include <algorithm>

namespace gsut {

// The third scale over the shorter of the others. Responses are then those at the ray's
// intersection with the disc's plane to 2e-5 up to 88 degrees from its normal.
inline constexpr double kSurfelThickness = 1e-4;
inline constexpr double kSurfelLogThickness = -9.210340371976182;

// Makes the third of three logarithms of scales a surfel's.
inline void PressSurfel(float* log_scales) {
  log_scales[2] = std::min(log_scales[0], log_scales[1]) + static_cast<float>(kSurfelLogThickness);
}

}  // namespace gsut
