// Domain and inverse of lenses that map directions to a plane, and then distort that plane.
#pragma once

#include "gsut/cameras/plane_map.h"

namespace gsut {

struct LensDomain;

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

}  // namespace gsut
