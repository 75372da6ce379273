// Domain and inverse of angle -> radius polynomials: the fisheye lenses without tangential terms.
#pragma once

namespace gsut {

struct LensDomain;

// params: fx fy cx cy k1 k2 ...; rd(theta) = theta (1 + k1 theta^2 + k2 theta^4 + ...). max_angle
// is the first theta > 0 where rd stops rising (or pixels come near kMaxPixel), at most angle_limit
// and pi; max_radius = rd(max_angle).
LensDomain OddPolynomialDomain(const double* params, int num_params, double angle_limit);

// Unit ray of a pixel; false if it has none.
bool UnprojectOddPolynomial(const LensDomain& domain, const double* params, int num_params,
                            double u, double v, double* ray);

}  // namespace gsut
