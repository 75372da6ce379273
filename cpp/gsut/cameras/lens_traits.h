// What a lens' file says of it beside its formula: for fits, and for tests that loop over lenses.
#pragma once

#include <vector>

#include "gsut/cameras/fit_axis.h"
#include "gsut/cameras/lens_registry.h"

namespace gsut {

// What does not depend on parameters; contract.h says what each means.
struct LensTraits {
  std::vector<int> choices;   // kChoices
  std::vector<int> fit_held;  // kFitHeld
  std::vector<int> fit_near;  // kFitNear
  bool has_table = false;     // kHasTable
  bool is_central = true;     // not kHasOrigins
  bool is_parallel = false;   // kIsParallel
};

LensTraits TraitsOf(LensModel lens);

// Whether a vector of this many parameters may be the lens.
bool LensAcceptsParams(LensModel lens, int num_params);

// Parameter vectors from which a fit starts: Lens::FitStarts, or fx fy cx cy and then zeros, as few
// as the lens accepts.
std::vector<std::vector<double>> LensFitStarts(LensModel lens, const FitAxis& at);

}  // namespace gsut
