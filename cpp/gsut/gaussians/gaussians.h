// The scene's parameters: a structure of arrays that somebody else owns (numpy, std::vector).
#pragma once

#include <cstdint>

namespace gsut {

inline constexpr int kMaxShDegree = 3;
inline constexpr int kMaxShCoefficients = (kMaxShDegree + 1) * (kMaxShDegree + 1);

// N Gaussians, row-major. T is float in training, double in the reference, const-qualified to read.
//   means           (N, 3) world coordinates
//   quats           (N, 4) w, x, y, z, any norm > 0: normalised where used
//   log_scales      (N, 3) natural logarithm of the standard deviations along the rotated axes
//   opacity_logits  (N,)   opacity = 1 / (1 + exp(-logit))
//   sh              (N, K, 3) spherical harmonics, K = (degree + 1)^2; colour = 0.5 + basis . sh
template <class T>
struct GaussiansView {
  std::int64_t size = 0;
  int sh_coefficients = 1;  // K
  T* means = nullptr;
  T* quats = nullptr;
  T* log_scales = nullptr;
  T* opacity_logits = nullptr;
  T* sh = nullptr;

  GaussiansView<const T> AsConst() const {
    return {size, sh_coefficients, means, quats, log_scales, opacity_logits, sh};
  }
};

}  // namespace gsut
