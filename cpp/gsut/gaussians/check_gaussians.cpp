// The sentences on what is wrong with arrays of Gaussians.
#include "gsut/gaussians/check_gaussians.h"

#include <string>

#include "gsut/base/errors.h"
#include "gsut/gaussians/harmonics.h"

namespace gsut {

void CheckGaussianArrays(std::int64_t size, int sh_coefficients, bool is_complete) {
  if (size < 0) {
    throw InputError("the number of Gaussians is " + std::to_string(size) + "; it is at least 0");
  }
  if (ShDegree(sh_coefficients) < 0) {
    throw InputError("sh_coefficients is " + std::to_string(sh_coefficients) +
                     "; degrees 0 to 3 have 1, 4, 9 and 16");
  }
  if (size > 0 && !is_complete) {
    throw InputError("means, quats, log_scales, opacity_logits or sh is null, and there are " +
                     std::to_string(size) + " Gaussians; give all five arrays");
  }
}

}  // namespace gsut
