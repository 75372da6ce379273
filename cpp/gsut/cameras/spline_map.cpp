// The splined lens' parameters, and its surface as a map of the plane.
#include "gsut/cameras/spline_map.h"

#include <cmath>
#include <sstream>

#include "gsut/base/errors.h"
#include "gsut/cameras/contract.h"
#include "gsut/cameras/lens_registry.h"

namespace gsut {

void CheckSplineParams(const char* lens, const double* params, int num_params) {
  constexpr double kMostPoints = 2000;  // in a row or column
  const double order = params[0], count_x = params[1], count_y = params[2], fov = params[3];
  std::ostringstream message;
  message << lens << ": ";
  if (order != 2.0 && order != 3.0) {
    message << "order is " << order << "; it must be 2 or 3";
    throw InputError(message.str());
  }
  for (const double count : {count_x, count_y}) {
    if (count >= order + 1.0 && count <= kMostPoints && count == std::floor(count)) continue;
    message << "Nx, Ny are " << count_x << ", " << count_y
            << "; they must be whole numbers from order + 1 to " << kMostPoints;
    throw InputError(message.str());
  }
  const int wanted = 8 + 2 * static_cast<int>(count_x) * static_cast<int>(count_y);
  if (num_params != wanted) {
    message << "Nx Ny 2 + 8 = " << wanted << " values are needed, found " << num_params;
    throw InputError(message.str());
  }
  CheckLensParam(lens, "fov_x_degrees", fov, 1e-3, 359.0);
  CheckFocalParams(lens, "fx fy cx cy control_points ...", params + 4, num_params - 4);
}

double SplineDensity(const double* params) {
  constexpr double kRadians = kPi / 180.0;
  return (params[1] - params[0]) / (4.0 * std::tan(0.25 * kRadians * params[3]));
}

PlaneMap SplineMap(const double* params) {
  return [params, density = SplineDensity(params)](double x, double y) {
    double value[2], dx[2], dy[2];
    lenses::SplinedStereographic::Spline(params, density, x, y, value, dx, dy);
    return PlanePoint{x + value[0], y + value[1], 1.0 + dx[0], dy[0], dx[1], 1.0 + dy[1]};
  };
}

}  // namespace gsut
