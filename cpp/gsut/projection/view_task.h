// The input of every float kernel of projection: Gaussians, lens, the camera's place, cut-offs.
#pragma once

#include <cmath>
#include <limits>

#include "gsut/cameras/lens_kernels.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/projection/project.h"
#include "gsut/projection/view.h"

namespace gsut {

struct ViewTask {
  GaussiansView<const float> gaussians;  // sh is not read
  FloatLens lens;
  ViewFloats view;
  float log2_raw_min;  // see Log2RawOf
  float max_cutoff;
};

// Throws InputError if the kernels cannot take the lens.
inline ViewTask MakeViewTask(const GaussiansView<const float>& gaussians, const Camera& camera,
                             const Pose& camera_from_world, const FootprintRule& rule) {
  return {gaussians, FloatLens(camera), MakeViewFloats(camera_from_world),
          static_cast<float>(Log2RawOf(gaussians.response, rule.alpha_min)),
          rule.response_min > 0.0 ? static_cast<float>(-2.0 * std::log(rule.response_min))
                                  : std::numeric_limits<float>::max()};
}

}  // namespace gsut
