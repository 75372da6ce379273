// The primitives' names, and their responses in double.
//
// With l = ln f at the cut-off, which is a Gaussian's -D^2 / 2 there, a triangle ends at the gauge
// g = r (1 - e^l). Its slope is that of ln (1 - g / r) by -g^2 / 2: 1 / (r g (1 - g / r)). Vector
// kernels have the same in projection/seen-inl.h and raster/lines/flat_hit-inl.h.
#include "gsut/gaussians/primitive.h"

#include <algorithm>
#include <cmath>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

constexpr const char* kNames[] = {"gaussian", "triangle"};
// Of g: the derivative of g^2 / 2 to (x, y) is 0 at the centre.
constexpr double kLeastGauge = 1e-17;

// 1 - g / r at g^2. 0 beyond the outline, however little an alpha is drawn: a response kept above 0
// there would have the slope of the inside everywhere in the plane.
double RestOf(double gauge2) { return std::max(1.0 - std::sqrt(gauge2) / triangle::kRadius, 0.0); }

}  // namespace

std::vector<std::string> PrimitiveNames() { return {std::begin(kNames), std::end(kNames)}; }

Primitive PrimitiveNamed(const std::string& name) {
  std::string known;
  for (int i = 0; i < static_cast<int>(std::size(kNames)); ++i) {
    if (name == kNames[i]) return static_cast<Primitive>(i);
    known += (i == 0 ? "" : ", ") + std::string(kNames[i]);
  }
  throw InputError("primitive \"" + name + "\" is unknown; known: " + known);
}

const char* NameOf(Primitive primitive) { return kNames[static_cast<int>(primitive)]; }

// The area in which the gauge is below g is that of a circle of radius g times kArea.
double WidthOf(Primitive primitive) {
  if (!IsFlat(primitive)) return 1.0;
  constexpr double kHalf = 2.0 * 0.69314718055994530942;  // D^2 of a Gaussian at half its response
  return std::sqrt(triangle::kArea * Profile{primitive}.Cutoff(kHalf) / kHalf);
}

// Of the three edges' forms the two that go up at the sides differ in the sign of x alone.
double Profile::Gauge(double x, double y, double* slopes) const {
  const double side = x < 0.0 ? -triangle::kRoot3 : triangle::kRoot3;
  const double upper = side * x + y, lower = -2.0 * y;
  slopes[0] = upper < lower ? 0.0 : side;
  slopes[1] = upper < lower ? -2.0 : 1.0;
  return std::max(upper, lower);
}

double Profile::Response(double d2) const {
  return IsGaussian() ? std::exp(-0.5 * d2) : RestOf(d2);
}

double Profile::Slope(double d2) const {
  if (IsGaussian()) return 1.0;
  const double rest = RestOf(d2);
  if (rest == 0.0) return 0.0;
  return 1.0 / (triangle::kRadius * std::max(std::sqrt(d2), kLeastGauge) * rest);
}

double Profile::Cutoff(double gaussian_cutoff) const {
  if (IsGaussian()) return gaussian_cutoff;
  const double gauge = triangle::kRadius * -std::expm1(-0.5 * gaussian_cutoff);
  return gauge * gauge;
}

}  // namespace gsut
