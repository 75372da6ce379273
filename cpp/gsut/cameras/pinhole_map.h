// Domain and inverse of the pinhole.
#pragma once

namespace gsut {

struct LensDomain;

// limits[0] is the squared tangent of max_angle.
LensDomain PinholeDomain(const double* params, double angle_limit);

// Unit ray of a pixel; false if it has none.
bool UnprojectPinhole(const LensDomain& domain, const double* params, double u, double v,
                      double* ray);

}  // namespace gsut
