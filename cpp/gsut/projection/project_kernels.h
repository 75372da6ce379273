// The call into the vectorised projection of the active instruction set.
#pragma once

#include <cstdint>

#include "gsut/projection/project.h"
#include "gsut/projection/view_task.h"

namespace gsut {

struct ProjectTask : ViewTask {
  int width, height;
  UnscentedWeights weights;
  float wide;  // pixels; larger footprints are left to the exact tile test
};

// Projects the Gaussians [begin, end); begin is a multiple of 16. Splats have room for 16 more.
void ProjectKernel(const ProjectTask& task, std::int64_t begin, std::int64_t end, Splats* splats);

// Floats in a vector of the active instruction set: 4, 8 or 16.
int ActiveLanes();

}  // namespace gsut
