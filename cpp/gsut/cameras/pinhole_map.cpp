// Domain and inverse of the pinhole.
#include "gsut/cameras/pinhole_map.h"

#include <algorithm>
#include <cmath>

#include "gsut/cameras/contract.h"

namespace gsut {

// Radius tan(theta): never beyond 90 degrees, nor so near them that pixels overflow.
LensDomain PinholeDomain(const double* params, double angle_limit) {
  LensDomain domain;
  double radius = LargestDistortedRadius(params);
  if (angle_limit < 0.5 * kPi) radius = std::min(radius, std::tan(angle_limit));
  domain.max_angle = std::atan(radius);
  domain.max_radius = radius;
  domain.limits[0] = radius * radius;
  return domain;
}

bool UnprojectPinhole(const LensDomain& domain, const double* params, double u, double v,
                      double* ray) {
  double x = 0.0, y = 0.0;
  if (!FromPixel(params, u, v, &x, &y) || !(x * x + y * y < domain.limits[0])) return false;
  // (x, y, 1) is the ray at depth one.
  const double norm = std::sqrt(1.0 + x * x + y * y);
  ray[0] = x / norm;
  ray[1] = y / norm;
  ray[2] = 1.0 / norm;
  return true;
}

}  // namespace gsut
