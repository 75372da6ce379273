// The call into the vectorised footprints of the active instruction set.
#pragma once

#include <cstdint>

#include "gsut/cameras/lens_registry.h"
#include "gsut/projection/footprint.h"
#include "gsut/projection/lens_bend.h"
#include "gsut/projection/sigma_rule.h"
#include "gsut/projection/view.h"

namespace gsut {

// Points of an outline: float kernel and double reference.
inline constexpr int kOutlinePoints = 16;
inline constexpr int kOutlinePointsReference = 64;

struct FootprintTask {
  GaussiansView<const float> gaussians;  // sh is not read
  LensModel lens;
  LensDomain domain;
  const double* params;
  int num_params;
  const float* table;  // the parameters in float, for lenses with a table
  ViewFloats view;
  float log2_alpha_min;
  float max_cutoff;
  ProjectionMethod method;  // not kAdaptive
  const SigmaRule* rule;
  const Bend* bend = nullptr;  // LensBend::table()
};

// Bounds of the errors (footprint_error.h) of the Gaussians from `first` on. Vectors of Gaussians
// none of which has a centre within `limit` (pixels), by EWA or unscented, get no footprint.
struct FootprintErrors {
  std::int64_t first = 0;
  float limit = 0.0f;
  AlignedVector<float> ewa, unscented_center, unscented_box;
};

// Footprints of the Gaussians [begin, end), begin a multiple of 16; errors may be null, or
// task.bend is there. Arrays have room for 16 more. Boxes come widened by kBoxRounding.
void FootprintKernel(const FootprintTask& task, std::int64_t begin, std::int64_t end,
                     Footprints<float>* footprints, FootprintErrors* errors);

}  // namespace gsut
