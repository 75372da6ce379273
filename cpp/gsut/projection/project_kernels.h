// The call into the vectorised projection of the active instruction set.
#pragma once

#include <cstdint>

#include "gsut/cameras/lens_kernels.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/projection/project.h"
#include "gsut/projection/view.h"

namespace gsut {

struct ProjectTask {
  GaussiansView<const float> gaussians;  // sh is not read
  FloatLens lens;
  ViewFloats view;
  float log2_raw_min;  // see Log2RawOf
  float max_cutoff;
  int width, height;
  UnscentedWeights weights;
  float wide;  // pixels; larger footprints are left to the exact tile test
};

// Projects the Gaussians [begin, end); begin is a multiple of 16. Splats have room for 16 more.
void ProjectKernel(const ProjectTask& task, std::int64_t begin, std::int64_t end, Splats* splats);

// Floats in a vector of the active instruction set: 4, 8 or 16.
int ActiveLanes();

}  // namespace gsut
