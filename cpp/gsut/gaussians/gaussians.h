// The scene's parameters: a structure of arrays that somebody else owns (numpy, std::vector).
#pragma once

#include <cstdint>

#include "gsut/gaussians/activations.h"
#include "gsut/gaussians/primitive.h"
#include "gsut/gaussians/order.h"
#include "gsut/gaussians/response.h"

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
  // Scales and opacities as they are: log_scales holds standard deviations and opacity_logits
  // opacities in [0, 1]. Gradients are to these.
  bool is_linear = false;
  // The rule by which they are drawn; of linear ones the maximum only.
  Response response = Response::kMaximum;
  // How their responses fall.
  Primitive primitive = Primitive::kGaussian;
  // In which they are blended, unless the blend rule says another.
  OrderKey order = OrderKey::kDistance;

  GaussiansView<const T> AsConst() const {
    return {size, sh_coefficients, means,    quats,     log_scales, opacity_logits,
            sh,   is_linear,       response, primitive, order};
  }
  // Of Gaussian i in double: its standard deviation along axis k, and its opacity.
  double Scale(std::int64_t i, int k) const {
    const double stored = static_cast<double>(log_scales[3 * i + k]);
    return is_linear ? stored : ScaleFromLog(stored);
  }
  double Opacity(std::int64_t i) const {
    const double stored = static_cast<double>(opacity_logits[i]);
    return is_linear ? stored : Sigmoid(stored);
  }
  // Of Gaussian i in double, what its response is multiplied by: see Response.
  double Strength(std::int64_t i) const {
    if (response == Response::kMaximum) return Opacity(i);
    return Softplus(static_cast<double>(opacity_logits[i]));
  }
  // Derivative of the stored value to the logarithm of the scale, and that of the strength to the
  // stored opacity: chain rules of gradients.
  double LogScaleSlope(double scale) const { return is_linear ? 1.0 / scale : 1.0; }
  double StrengthSlope(double strength) const {
    if (response != Response::kMaximum) return -std::expm1(-strength);
    return is_linear ? 1.0 : SigmoidDerivative(strength);
  }
};

}  // namespace gsut
