// Domain and inverse of the radial-tangential lenses (OpenCV 4, 5, 8, 12, 14 coefficients).
#pragma once

namespace gsut {

struct LensDomain;

// params: fx fy cx cy, then k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]; num_params is 8, 9,
// 12, 16 or 18. In the plane (x, y) = (X/Z, Y/Z) the domain is a disc: up to the first root of the
// derivative of the radial part or its first pole, or where pixels come near kMaxPixel; for lenses
// with other terms up to the first circle on which the map stops being regular (RegularRadius).
// limits[0] is the squared radius of the disc, limits[1] the smallest radius of its image's
// boundary.
LensDomain RadialTangentialDomain(const double* params, int num_params, double angle_limit);

// Unit ray of a pixel; false if it has none.
bool UnprojectRadialTangential(const LensDomain& domain, const double* params, int num_params,
                               double u, double v, double* ray);

}  // namespace gsut
