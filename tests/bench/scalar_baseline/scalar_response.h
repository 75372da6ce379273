// One ray against one Gaussian in scalar float: the cross-product form of 3DGUT.
#pragma once

#include <cmath>

#include "gsut/raster/blend_rule.h"

namespace gsut {

inline float Dot3(const float* a, const float* b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

inline void Cross3(const float* a, const float* b, float* out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

// A ray and a Gaussian: what forward and backward both need.
struct RayResponse {
  float unit[3];   // u = A d / |A d|
  float cross[3];  // A m x u, of squared length D^2
  float inverse_length;
  float response, alpha;
  bool clamped;  // alpha is the rule's alpha_max
};

// The cut-offs of a blend rule, in float.
struct Cutoffs {
  explicit Cutoffs(const BlendRule& rule)
      : alpha_min(static_cast<float>(rule.alpha_min)),
        alpha_max(static_cast<float>(rule.alpha_max)),
        response_min(static_cast<float>(rule.response_min)) {}
  float alpha_min, alpha_max, response_min;
};

// Whether the rule draws the Gaussian on the ray d. whiten: A = S^-1 R^T, row-major; whitened: A m,
// m the mean, both about the camera centre.
inline bool EvaluateResponse(const float* whiten, const float* whitened, float opacity,
                             const float* ray, const Cutoffs& cutoffs, RayResponse* out) {
  const float w[3] = {Dot3(whiten, ray), Dot3(whiten + 3, ray), Dot3(whiten + 6, ray)};
  out->inverse_length = 1.0f / std::sqrt(Dot3(w, w));
  for (int k = 0; k < 3; ++k) out->unit[k] = w[k] * out->inverse_length;
  if (!(Dot3(whitened, out->unit) > 0.0f)) return false;  // behind the camera
  Cross3(whitened, out->unit, out->cross);
  out->response = std::exp(-0.5f * Dot3(out->cross, out->cross));
  const float raw = opacity * out->response;
  out->clamped = raw > cutoffs.alpha_max;
  out->alpha = out->clamped ? cutoffs.alpha_max : raw;
  return out->alpha >= cutoffs.alpha_min && out->response > cutoffs.response_min;
}

}  // namespace gsut
