// Domains and inverses of lenses that distort a plane of directions.
#pragma once

#include "gsut/cameras/plane_map.h"

namespace gsut {

struct LensDomain;

// Lenses that map directions to a plane, and then distort that plane.

// The plane: (X, Y) over its length, times a radius that is a function of the angle from the axis.
enum class PlaneChart {
  kGnomonic,       // tan(angle)
  kEquidistant,    // angle
  kStereographic,  // 2 tan(angle / 2)
};

// params: fx fy cx cy, the last step after `distortion`, which maps the plane to focal lengths. The
// domain is the cone up to the first circle on which the map stops being regular (RegularRadius,
// about the image of the axis), up to angle_limit, and where pixels come near kMaxPixel. Sets
// limits[0], the squared radius of the circle in the plane; limits[1] and max_radius, the smallest
// and largest distance of its image from the image of the axis; and limits[3] (see SetCone).
LensDomain PlaneChartDomain(PlaneChart chart, const double* params, const PlaneMap& distortion,
                            double angle_limit);

// Unit ray of a pixel; false if it has none.
bool UnprojectPlaneChart(PlaneChart chart, const LensDomain& domain, const double* params,
                         const PlaneMap& distortion, double u, double v, double* ray);

// The radial-tangential lenses (OpenCV 4, 5, 8, 12, 14 coefficients).

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
