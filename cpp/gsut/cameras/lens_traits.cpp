// What a lens' file says of it beside its formula: for fits, and for tests that loop over lenses.
#include "gsut/cameras/lens_traits.h"

#include <iterator>

#include "gsut/cameras/visit_lens.h"

namespace gsut {

// `requires` asks the struct whether it declares an optional member; contract.h lists them.
LensTraits TraitsOf(LensModel lens) {
  return VisitLens(lens, [](auto model) {
    using Lens = decltype(model);
    LensTraits traits;
    if constexpr (requires { Lens::kChoices; }) {
      traits.choices.assign(std::begin(Lens::kChoices), std::end(Lens::kChoices));
    }
    if constexpr (requires { Lens::kFitHeld; }) {
      traits.fit_held.assign(std::begin(Lens::kFitHeld), std::end(Lens::kFitHeld));
    }
    if constexpr (requires { Lens::kFitNear; }) {
      traits.fit_near.assign(std::begin(Lens::kFitNear), std::end(Lens::kFitNear));
    }
    traits.has_table = requires { Lens::kHasTable; };
    traits.is_central = !requires { Lens::kHasOrigins; };
    traits.is_parallel = requires { Lens::kIsParallel; };
    return traits;
  });
}

bool LensAcceptsParams(LensModel lens, int num_params) {
  return VisitLens(lens, [=](auto model) { return decltype(model)::AcceptsParams(num_params); });
}

std::vector<std::vector<double>> LensFitStarts(LensModel lens, const FitAxis& at) {
  return VisitLens(lens, [&](auto model) -> std::vector<std::vector<double>> {
    using Lens = decltype(model);
    if constexpr (requires { Lens::FitStarts(at); }) {
      return Lens::FitStarts(at);
    } else {
      // The shortest list of parameters that the lens accepts, without distortion.
      std::vector<double> start = at.With({});
      while (!Lens::AcceptsParams(static_cast<int>(start.size()))) start.push_back(0.0);
      return {start};
    }
  });
}

}  // namespace gsut
