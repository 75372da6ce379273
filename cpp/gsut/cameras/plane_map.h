// Domain and inverse of a smooth map of the plane: lenses that are not symmetric about the axis.
#pragma once

#include <functional>

#include "gsut/cameras/dual.h"

namespace gsut {

// Value and Jacobian of a map (x, y) -> (u, v) that takes (0, 0) to itself.
struct PlanePoint {
  double u, v;
  double du_dx, du_dy, dv_dx, dv_dy;
};
using PlaneMap = std::function<PlanePoint(double x, double y)>;

// The map of a function distort(x, y, u*, v*) written for Dual<2>.
template <class Distort>
PlaneMap MakePlaneMap(Distort distort) {
  return [distort](double x, double y) {
    Dual<2> u, v;
    distort(Dual<2>(x, 0), Dual<2>(y, 1), &u, &v);
    return PlanePoint{u.value, v.value, u.grad[0], u.grad[1], v.grad[0], v.grad[1]};
  };
}

// The largest R <= limit (finite) such that on each circle of radius r < R, for all
// azimuths, the determinant of the Jacobian is positive and the image of the circle turns strictly
// one way around the origin. Then the map is one-to-one on the disc of radius R, and the image of
// the disc is star-shaped about the origin, which is what InvertPlaneMap relies on.
// Sampled on a polar grid (64 azimuths x 256 radii, uniform in atan(r), and more towards a far
// limit), the boundary refined by bisection in radius and golden section in azimuth, minus a
// relative 1e-9. Of circles up to the first that `is_sure` does not vouch for, none is looked at.
double RegularRadius(const PlaneMap& map, double limit,
                     const std::function<bool(double radius)>& is_sure = nullptr);

// The smallest and the largest |(u, v)| on the circle of this radius, sampled and refined likewise.
struct ImageRadii {
  double smallest, largest;
};
ImageRadii ImageOfCircle(const PlaneMap& map, double radius);

// The part of a disc, on which the map is regular, that it keeps within `largest` of the origin.
double RadiusWithin(const PlaneMap& map, double radius, double largest);

// Whether (u, v) lies in the image of the disc of this radius, by comparing it with the point of
// the boundary's image in the same direction from the origin (unique: see RegularRadius).
bool ImageOfDiscContains(const PlaneMap& map, double radius, double u, double v);

// Finds (x, y) inside the disc of this radius with map(x, y) = (u, v), by Newton from (*x, *y), and
// if that fails by following the segment from the origin to (u, v), which lies in the image of the
// disc (see RegularRadius). False if the image of the disc does not hold (u, v).
bool InvertPlaneMap(const PlaneMap& map, double radius, double u, double v, double* x, double* y);

}  // namespace gsut
