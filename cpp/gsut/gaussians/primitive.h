// Primitives, and how their responses fall: ellipsoids as a Gaussian's levels, or a flat triangle.
//
// gaussian: exp(-D^2 / 2), D the smallest Mahalanobis distance along the ray. Surfels are Gaussians
// that are thin along one axis (gaussians/surfels.h).
// triangle: flat, 1 - g / r with g growing from 0 at the centre to r at the outline, 0 beyond. It
// lies in the plane of the first two axes, and its third scale is not read. With (x, y) where the
// ray meets the plane, in units of the scales, the gauge g = max(-2 y, sqrt(3) |x| + y) takes the
// place of D: nowhere below it, convex and of degree 1. The corners of g = 1 lie on the unit
// circle, one of them at (0, 1); two scales and a rotation make every isosceles triangle of it, and
// no other. r^2 = 40 / 3 makes the second moments of the response those of a Gaussian of the same
// scales. Triangles are drawn as lines in space through every lens, see raster/lines.
// Sources: Kerbl et al., "3D Gaussian splatting for real-time radiance field rendering", 2023; Held
// et al., "Triangle splatting", 2025, whose window falls with the distance from the outline in the
// image; here it is taken in the triangle's plane, the same through every lens.
#pragma once

#include <string>
#include <vector>

namespace gsut {

enum class Primitive : int { kGaussian = 0, kTriangle = 1 };

namespace triangle {
inline constexpr double kRoot3 = 1.73205080756887729353;
// The gauge is the largest of these linear forms of (x, y).
inline constexpr double kEdges[3][2] = {{0.0, -2.0}, {kRoot3, 1.0}, {-kRoot3, 1.0}};
// The area where the gauge is below 1, over that of the unit circle.
inline constexpr double kArea = 0.41349667156634407;
inline constexpr double kRadius = 3.65148371670110744;  // r
}  // namespace triangle

// All names, in the order of Primitive.
std::vector<std::string> PrimitiveNames();

// Throws InputError with the known names if there is no such primitive.
Primitive PrimitiveNamed(const std::string& name);
const char* NameOf(Primitive primitive);

// Whether it is a polygon in the plane of its first two axes.
constexpr bool IsFlat(Primitive primitive) { return primitive == Primitive::kTriangle; }

// The size of each at half its response over a Gaussian's of the same scales: the square root of
// the ratio of areas.
double WidthOf(Primitive primitive);

// How one primitive's response falls, in double.
struct Profile {
  Primitive primitive = Primitive::kGaussian;

  bool IsGaussian() const { return primitive == Primitive::kGaussian; }
  // Of a triangle, in place of D; slopes[2]: its derivatives.
  double Gauge(double x, double y, double* slopes) const;
  // f and d ln f / d(-D^2 / 2) at D^2; beyond a triangle's outline both are 0.
  double Response(double d2) const;
  double Slope(double d2) const;
  // D^2 at which f equals exp(-gaussian_cutoff / 2), a Gaussian's at its cut-off.
  double Cutoff(double gaussian_cutoff) const;
};

}  // namespace gsut
