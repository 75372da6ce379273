// Adam's step of the harmonics, bound: optimize makes it, raster takes it.
#pragma once

#include <pybind11/pybind11.h>

#include <array>

#include "gsut/gaussians/harmonics_step.h"

namespace gsut::bindings {

// The step, and the arrays that it points to.
struct BoundHarmonicsStep {
  HarmonicsStep step;
  std::array<pybind11::object, 3> arrays;
};

}  // namespace gsut::bindings
