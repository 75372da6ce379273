// What copies of one Camera share; for the .cpp files of Camera only.
#pragma once

#include <mutex>
#include <vector>

#include "gsut/cameras/camera.h"

namespace gsut {

struct Camera::State {
  LensModel lens;
  std::vector<double> params;
  int width, height;
  double valid_field_angle;
  LensDomain domain;

  mutable std::once_flag rays_built;
  mutable RayTable rays;
};

}  // namespace gsut
