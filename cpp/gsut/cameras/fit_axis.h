// What a fit knows of the lens that it imitates before it starts.
#pragma once

#include <initializer_list>
#include <vector>

namespace gsut {

struct FitAxis {
  double fx, fy;     // pixels per radian on the axis (per world unit for parallel rays)
  double cx, cy;     // the pixel of the axis
  double max_angle;  // radians; the largest angle from the axis that is to be seen

  // fx fy cx cy and what follows them; the focal lengths times `stretch`.
  std::vector<double> With(std::initializer_list<double> others, double stretch = 1.0) const {
    std::vector<double> params = {stretch * fx, stretch * fy, cx, cy};
    params.insert(params.end(), others);
    return params;
  }
};

}  // namespace gsut
