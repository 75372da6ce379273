// The call into the vectorised projection of the active instruction set.
#pragma once

#include <cstdint>

#include "gsut/cameras/lens_registry.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/projection/project.h"
#include "gsut/projection/view.h"

namespace gsut {

// Most parameters a lens without a table may have in the kernels.
inline constexpr int kMaxLensParams = 64;

struct ProjectTask {
  GaussiansView<const float> gaussians;
  LensModel lens;
  LensDomain domain;
  const double* params;
  int num_params;
  const float* table;  // the parameters in float, for lenses with a table
  int width, height;
  ViewFloats view;
  UnscentedWeights weights;
  float log2_alpha_min;
  float max_cutoff;
  float wide;  // pixels; larger footprints are left to the exact tile test
};

// Projects the Gaussians [begin, end); begin is a multiple of 16. Splats have room for 16 more.
void ProjectKernel(const ProjectTask& task, std::int64_t begin, std::int64_t end, Splats* splats);

// Floats in a vector of the active instruction set: 4, 8 or 16.
int ActiveLanes();

}  // namespace gsut
