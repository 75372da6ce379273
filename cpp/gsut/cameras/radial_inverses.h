// Domains and inverses of lenses whose image radius depends on the angle from the axis alone.
#pragma once

#include <functional>

namespace gsut {

struct LensDomain;

// Cones, and any radius that rises with the angle.

// Throws InputError unless low <= value <= high.
void CheckLensParam(const char* lens, const char* name, double value, double low, double high);

// max_angle = angle, and limits[3] as families/cone.h wants it: the tangent of half of it, or
// infinity for pi.
void SetCone(double angle, LensDomain* domain);

// radius(angle): distorted radius in focal lengths, increasing on (0, angle); beyond a pole it may
// be anything that is negative, not finite or huge. The domain ends at `angle`, at angle_limit, or
// where pixels come near kMaxPixel. Sets max_angle, max_radius and limits[3].
LensDomain RadialDomain(const double* params, double angle, double angle_limit,
                        const std::function<double(double angle)>& radius);

// The direction (x, y, z), of any length but 0, as a unit ray; false if it lies outside the cone of
// the domain (limits[3]).
bool RayInCone(const LensDomain& domain, double x, double y, double z, double* ray);

// The pinhole.

// limits[0] is the squared tangent of max_angle.
LensDomain PinholeDomain(const double* params, double angle_limit);

// Unit ray of a pixel; false if it has none.
bool UnprojectPinhole(const LensDomain& domain, const double* params, double u, double v,
                      double* ray);

// Angle -> radius polynomials: the fisheye lenses without tangential terms.

// params: fx fy cx cy k1 k2 ...; rd(theta) = theta (1 + k1 theta^2 + k2 theta^4 + ...). max_angle
// is the first theta > 0 where rd stops rising (or pixels come near kMaxPixel), at most angle_limit
// and pi; max_radius = rd(max_angle).
LensDomain OddPolynomialDomain(const double* params, int num_params, double angle_limit);

// Unit ray of a pixel; false if it has none.
bool UnprojectOddPolynomial(const LensDomain& domain, const double* params, int num_params,
                            double u, double v, double* ray);

// The f-theta lens.

// params: see models/ftheta.h. Throws InputError if B is the reference and the lens' steps from A
// do not find its inverse.
LensDomain FthetaDomain(const double* params, double angle_limit);

// Unit ray of the offset (x, y) from the principal point, in pixels; false if it has none.
bool UnprojectFtheta(const LensDomain& domain, const double* params, double x, double y,
                     double* ray);

// The polynomial fisheye of OCamCalib.

// params: see models/ocam.h. limits[0..2] hold the odd polynomial of the angle from which the lens'
// Newton steps start; the domain ends where they no longer find rho to rounding.
LensDomain OcamDomain(const double* params, int num_params, double angle_limit);

}  // namespace gsut
