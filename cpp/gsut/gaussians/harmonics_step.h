// Adam's step of the harmonics, for kernels that take it where the gradients are made.
#pragma once

#include <array>

#include "gsut/gaussians/gaussians.h"

namespace gsut {

// The constants of one step of Adam, rounded to float once.
struct AdamConstants {
  float beta1, one_minus_beta1, beta2, one_minus_beta2;
  float inverse_sqrt_correction2;  // 1 / sqrt(1 - beta2^step)
  float epsilon;
};

// Harmonics (N, K, 3) and their moments. The gradients of a row then pass from registers into its
// step: written to memory and read again, they took as much of it as the moments.
struct HarmonicsStep {
  AdamConstants constants;
  float* params;
  float* moment1;
  float* moment2;
  int active;  // floats of a row that are stepped
  // Of each of these, with the first moment's bias correction.
  std::array<float, 3 * kMaxShCoefficients> rates;
};

}  // namespace gsut
