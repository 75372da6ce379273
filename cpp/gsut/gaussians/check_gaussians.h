// Checks of arrays at the edge of the API, so that no loop over them has to.
#pragma once

#include <cstdint>

#include "gsut/base/errors.h"
#include "gsut/gaussians/gaussians.h"

namespace gsut {

// Throws InputError unless `size` is not negative, the harmonics are of degree 0 to 3 and, where
// there are rows, `is_complete`.
void CheckGaussianArrays(std::int64_t size, int sh_coefficients, bool is_complete);

// Throws InputError unless each array is there and its shape can be.
template <class T>
void CheckGaussians(const GaussiansView<T>& g) {
  CheckGaussianArrays(g.size, g.sh_coefficients,
                      g.means && g.quats && g.log_scales && g.opacity_logits && g.sh);
}

// Throws InputError unless gradients have an array each and are shaped like the Gaussians.
template <class T>
void CheckGradients(const GaussiansView<T>& gradients, const GaussiansView<const T>& of) {
  CheckGaussians(gradients);
  if (gradients.size == of.size && gradients.sh_coefficients == of.sh_coefficients &&
      gradients.is_linear == of.is_linear) {
    return;
  }
  throw InputError("gradients must be shaped like the rendered Gaussians");
}

}  // namespace gsut
