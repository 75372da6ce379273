// Primitives with ellipsoids or flat polygons as their levels: how the response falls.
//
// One primitive = one file under primitives/, found by the build; this is its contract. A ray comes
// within the Mahalanobis distance D of the mean; v = log2 exp(-D^2 / 2) is what a Gaussian's
// response would be. A file says what becomes of it, as text for double and for vectors:
//   LogResponse(v, b)  log2 of the response f, 0 at v = 0, falling;
//   Slope(v, b)        its derivative by v;
//   ShapeSlope(v, b)   its derivative by b;
//   Invert(l, b)       the v at which log2 f is l, where f ends if it ends before;
//   Activate(x)        b, a number of each primitive, of which x is stored (kHasShape; else neither
//                      is read), and ActivationSlope(x) its derivative.
// A flat one lies in the plane of the first two axes, and its third scale is not read. With (x, y)
// where the ray meets the plane, in units of the scales, a gauge takes the place of D:
//   Gauge(x, y)        of degree 1, convex, nowhere below D; and its derivatives;
//   kEdges             the linear forms of (x, y) whose largest it is;
//   kArea              the area of the polygon Gauge < 1, over that of the unit circle;
//   Radius(b)          r, where f = (1 - gauge / r)^b ends, and RadiusSlope(b), its derivative.
// Flat ones are drawn as lines in space through every lens, see raster/lines.
// All else, the point of the nearest pass, the hit test without division, tiles, gradients to
// means, rotations, scales and rays, densification and files, is that of the Gaussian: the cut-off
// of D^2 and dlog f / dv are all that changes.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "gsut_primitive_list.h"

namespace gsut {

// kBeta, kGaussian ...: one value a file, in the order of their names.
enum class Primitive : int {
#define GSUT_PRIMITIVE_VALUE(Kind) k##Kind,
  GSUT_FOR_EACH_PRIMITIVE(GSUT_PRIMITIVE_VALUE)
#undef GSUT_PRIMITIVE_VALUE
};

// All names, in the order of Primitive.
std::vector<std::string> PrimitiveNames();

// Throws InputError with the known names if there is no such primitive.
Primitive PrimitiveNamed(const std::string& name);
const char* NameOf(Primitive primitive);

// Whether each primitive has a number of its own beside the Gaussian's parameters.
bool HasShape(Primitive primitive);

// Whether it is a polygon in the plane of its first two axes.
bool IsFlat(Primitive primitive);

// The size of each at half its response over a Gaussian's of the same scales: the square root of
// the ratio of areas.
double WidthOf(Primitive primitive);

// Stored shapes that tests loop over; one that is not read for primitives without.
std::span<const double> ExampleShapes(Primitive primitive);

// How one primitive's response falls, in double.
struct Profile {
  Primitive primitive = Primitive::kGaussian;
  double stored = 0.0;  // the shape as stored

  bool IsGaussian() const { return primitive == Primitive::kGaussian; }
  // Of a flat primitive, in place of D; slopes[2]: its derivatives.
  double Gauge(double x, double y, double* slopes) const;
  // f, d ln f / d(-D^2 / 2) and d ln f / dstored at D^2.
  double Response(double d2) const;
  double Slope(double d2) const;
  double StoredSlope(double d2) const;
  // D^2 at which f equals exp(-gaussian_cutoff / 2), a Gaussian's at its cut-off.
  double Cutoff(double gaussian_cutoff) const;
  // The shape b, and d b / dstored.
  double Shape() const;
  double ActivationSlope() const;
};

}  // namespace gsut
