// A camera's place as the float kernels take it.
#pragma once

#include "gsut/geometry/pose.h"

namespace gsut {

// The camera centre is split into two floats, so that mean - centre is correctly rounded to float
// (to 1 ulp of the difference) without double arithmetic in the kernel.
struct ViewFloats {
  float center_high[3], center_low[3];
  float rotation[9];      // camera_from_world, row-major
  float rotation_low[9];  // what rounding to float took from it
};

inline ViewFloats MakeViewFloats(const Pose& camera_from_world) {
  ViewFloats view;
  const Eigen::Vector3d center = camera_from_world.CenterInSource();
  for (int k = 0; k < 3; ++k) {
    view.center_high[k] = static_cast<float>(center[k]);
    view.center_low[k] = static_cast<float>(center[k] - static_cast<double>(view.center_high[k]));
    for (int j = 0; j < 3; ++j) {
      const double exact = camera_from_world.rotation(k, j);
      view.rotation[3 * k + j] = static_cast<float>(exact);
      view.rotation_low[3 * k + j] =
          static_cast<float>(exact - static_cast<double>(view.rotation[3 * k + j]));
    }
  }
  return view;
}

}  // namespace gsut
