// What a render says of the surface behind each pixel, beside the expected distance.
#pragma once

namespace gsut {

// Row-major; each may be null. A Gaussian's distance is that of its strongest response along the
// ray, from the ray's own origin.
struct SurfaceMaps {
  float* median = nullptr;     // (H, W) of the Gaussian at which the transmittance falls below 1/2;
                               // NaN where it never does
  float* strongest = nullptr;  // (H, W) of the Gaussian with the largest blend weight; NaN: none
  // (H, W, 3) world axes: sum of blend weight x unit normal. A Gaussian's normal is that of the
  // surface which its strongest responses along all rays from one origin form,
  // x Q (x - m) = 0 with Q the inverse covariance, m the mean, x from the origin; at x it is
  // -Q (2 x - m), which faces the origin everywhere. Shorter than alpha where normals disagree.
  float* normals = nullptr;
  float* spread = nullptr;  // (H, W) standard deviation of the blended distances; NaN: none
};

}  // namespace gsut
