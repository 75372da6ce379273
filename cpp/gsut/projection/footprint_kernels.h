// The call into the vectorised footprints of the active instruction set.
#pragma once

#include <cstdint>

#include "gsut/projection/footprint.h"
#include "gsut/projection/view_task.h"

namespace gsut {

// Points of an outline: float kernel and double reference.
inline constexpr int kOutlinePoints = 16;
inline constexpr int kOutlinePointsReference = 64;

struct FootprintTask : ViewTask {
  ProjectionMethod method;
  UnscentedWeights weights;
};

// Footprints of the Gaussians [begin, end), begin a multiple of 16. Arrays have room for 16 more.
// Boxes come widened by kBoxRounding.
void FootprintKernel(const FootprintTask& task, std::int64_t begin, std::int64_t end,
                     Footprints<float>* footprints);

}  // namespace gsut
