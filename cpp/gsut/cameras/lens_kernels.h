// The vectorised lenses: many points in the camera frame to pixels, in float.
#pragma once

#include <vector>

#include "gsut/cameras/camera.h"

namespace gsut {

// Most parameters that the kernels take of a lens without a table.
inline constexpr int kMaxScalarParams = 64;

// A camera's lens as the kernels take it.
struct FloatLens {
  // Throws InputError if the lens has more parameters than the kernels take.
  explicit FloatLens(const Camera& camera);

  LensModel lens;
  LensDomain domain;
  int num_params;
  std::vector<float> params;  // and kMaxColumns zeros, which SumRows may read
};

// Structure of arrays on 64-byte boundaries. Pixels are NaN where the point has none.
struct LensBatch {
  const float *x, *y, *z;  // points in the camera frame
  float *u, *v;            // pixels
};

// Projects `count` points, a multiple of 16, on this thread, with the active instruction set. Error
// against Camera::Project: see LensKernelTest in tests/cpp/cameras_test.cpp.
void ProjectPoints(const FloatLens& lens, int count, const LensBatch& batch);

}  // namespace gsut
