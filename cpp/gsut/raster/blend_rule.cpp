// Presets of the blend rule.
#include "gsut/raster/blend_rule.h"

#include <sstream>
#include <string>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

constexpr double kLeastAlphaMin = 1e-37;

// Throws unless `holds`; a comparison with NaN does not.
void Require(bool holds, const char* field, double value, const char* wanted) {
  if (holds) return;
  std::ostringstream message;
  message << "the blend rule's " << field << " is " << value << "; it must be " << wanted;
  throw InputError(message.str());
}

}  // namespace

// The rules of other rasterizers, for comparison with their images: both order by camera z; gsplat
// leaves the Gaussian out that would cross the limit, 3DGRUT cuts responses off instead of alphas.
BlendRule BlendRule::Named(const std::string& name) {
  BlendRule rule;
  if (name.empty()) return rule;
  rule.order = OrderKey::kDepthZ;
  if (name == "gsplat") {
    rule.stop_before = true;
    rule.near_z = 0.01;
    rule.far_z = 1e10;
  } else if (name == "3dgrut") {
    rule.response_min = 0.0113;
    rule.near_z = 0.2;
  } else {
    throw InputError("parity \"" + name + "\" is unknown; known: gsplat, 3dgrut, or none");
  }
  return rule;
}

// Bounds that the kernels rely on: logarithms of alpha_min, and 1 - alpha never 0.
void BlendRule::Check() const {
  Require(alpha_min >= kLeastAlphaMin && alpha_min < 1.0, "alpha_min", alpha_min, "in [1e-37, 1)");
  Require(alpha_max > 0.0 && alpha_max < 1.0, "alpha_max", alpha_max, "in (0, 1)");
  Require(response_min >= 0.0 && response_min < 1.0, "response_min", response_min, "in [0, 1)");
  Require(transmittance_min >= 0.0 && transmittance_min < 1.0, "transmittance_min",
          transmittance_min, "in [0, 1)");
  Require(near_z <= far_z, "near_z", near_z, "a number, at most far_z");
}

void RenderSettings::Check() const {
  rule.Check();
  if (sh_degree < 0) {
    throw InputError("sh_degree is " + std::to_string(sh_degree) + "; it must be at least 0");
  }
}

}  // namespace gsut
