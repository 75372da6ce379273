// Presets of the blend rule.
#include "gsut/raster/blend_rule.h"

#include "gsut/base/errors.h"

namespace gsut {

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

}  // namespace gsut
