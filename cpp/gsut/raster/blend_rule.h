// The rule by which Gaussians along a ray become a pixel, and the presets of other implementations.
#pragma once

#include <limits>
#include <string>

#include "gsut/gaussians/order.h"

namespace gsut {

// Front-to-back blending. For each Gaussian in order:
//   response = exp(-D^2 / 2), D the smallest Mahalanobis distance along the ray; 0 where that point
//   lies behind the ray's origin (never drawn), or below response_min;
//   alpha = min(alpha_max, opacity * response), skipped below alpha_min; or of another rule of the
//   model's, see gaussians/response.h;
//   weight = alpha * T; T <- T (1 - alpha), T starting at 1; stop by transmittance_min.
struct BlendRule {
  double alpha_min = 1.0 / 255.0;
  double alpha_max = 0.99;
  double response_min = 0.0;
  double transmittance_min = 1e-4;
  // true: the Gaussian that would bring T to transmittance_min or below is not blended any more;
  // false: it is, and it is the last one.
  bool stop_before = false;
  OrderKey order = OrderKey::kModel;
  // Centres with camera z outside [near_z, far_z] are dropped. Off by default: a lens sees beyond
  // 90 degrees, where z is negative.
  double near_z = -std::numeric_limits<double>::infinity();
  double far_z = std::numeric_limits<double>::infinity();

  // "" (gsut's own), "gsplat" or "3dgrut"; any other name throws InputError.
  // gsplat: order by z, z in [0.01, 1e10], stops before. 3dgrut: order by z, z >= 0.2, stops after,
  // response > 0.0113. Both draw hits behind the origin in no case that this rule would not, but
  // 3dgrut does not test for them: gsut never draws them.
  static BlendRule Named(const std::string& name);

  // This rule for a model: with its order in place of kModel.
  BlendRule For(OrderKey of_model) const {
    BlendRule rule = *this;
    if (order == OrderKey::kModel) rule.order = of_model;
    return rule;
  }

  // Throws InputError, naming the field, unless 1e-37 <= alpha_min < 1 (float's exponent ends
  // there), 0 < alpha_max < 1 (the backward divides by 1 - alpha), response_min and
  // transmittance_min lie in [0, 1) and near_z <= far_z.
  void Check() const;
};

// The distortion of a pixel, the sum of weight x (distance - their weighted mean)^2, counts as 0
// where less than this is covered: there the mean says little.
inline constexpr double kDistortionAlpha = 1e-3;

struct RenderSettings {
  BlendRule rule;
  double background[3] = {0.0, 0.0, 0.0};
  // Harmonics above this degree are ignored (training switches them on one by one).
  int sh_degree = 3;

  // Throws InputError unless the rule can be (see BlendRule::Check) and the degree is at least 0.
  void Check() const;
};

}  // namespace gsut
