// Domain and inverse of the f-theta lens.
#pragma once

namespace gsut {

struct LensDomain;

// params: see models/ftheta.h. Throws InputError if B is the reference and the lens' steps from A
// do not find its inverse.
LensDomain FthetaDomain(const double* params, double angle_limit);

// Unit ray of the offset (x, y) from the principal point, in pixels; false if it has none.
bool UnprojectFtheta(const LensDomain& domain, const double* params, double x, double y,
                     double* ray);

}  // namespace gsut
