// Domains and inverses of lenses that distort a plane of directions.
#include "gsut/cameras/plane_inverses.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <span>
#include <sstream>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/cameras/contract.h"
#include "gsut/cameras/plane_map.h"
#include "gsut/cameras/polynomial.h"
#include "gsut/cameras/visit_lens.h"

namespace gsut {

// --- Lenses that map directions to a plane, and then distort that plane ---

namespace {

// Such a lens is a chart, which maps a direction at angle theta from the axis to a plane at radius
//   tan(theta) (gnomonic), theta (equidistant) or 2 tan(theta / 2) (stereographic),
// and a distortion of that plane. The chart has a closed inverse; the distortion is inverted by
// Newton's method (plane_map.h), and its domain is the largest disc on which it is one-to-one.

double RadiusOf(PlaneChart chart, double angle) {
  switch (chart) {
    case PlaneChart::kGnomonic:
      return angle < 0.5 * kPi ? std::tan(angle) : kInfinity;
    case PlaneChart::kEquidistant:
      return angle;
    case PlaneChart::kStereographic:
      return angle < kPi ? 2.0 * std::tan(0.5 * angle) : kInfinity;
  }
  __builtin_unreachable();
}

double AngleOf(PlaneChart chart, double radius) {
  switch (chart) {
    case PlaneChart::kGnomonic:
      return std::atan(radius);
    case PlaneChart::kEquidistant:
      return radius;
    case PlaneChart::kStereographic:
      return 2.0 * std::atan(0.5 * radius);
  }
  __builtin_unreachable();
}

// The largest radius that is looked at. Splines are asked up to 10 times their half width.
double LargestRadius(PlaneChart chart, const double* params) {
  constexpr double kStereographicLimit = 20.0;  // 168.6 degrees
  switch (chart) {
    case PlaneChart::kGnomonic:
      return LargestDistortedRadius(params);
    case PlaneChart::kEquidistant:
      return kPi;
    case PlaneChart::kStereographic:
      return kStereographicLimit;
  }
  __builtin_unreachable();
}

// A tangential term may move the image of the axis: discs are taken about it.
// The map about the image of the origin, which `center` receives.
PlaneMap Centred(const PlaneMap& map, double* center) {
  const PlanePoint p = map(0.0, 0.0);
  center[0] = p.u;
  center[1] = p.v;
  return [map, u0 = p.u, v0 = p.v](double x, double y) {
    PlanePoint q = map(x, y);
    q.u -= u0;
    q.v -= v0;
    return q;
  };
}

// (u, v) about the image of the axis -> (x, y) in the disc.
bool Undistort(const LensDomain& domain, const PlaneMap& map, double u, double v, double* x,
               double* y) {
  // Should the sampling of the two radii have missed a little.
  constexpr double kSlack = 1.02;
  const double distorted = std::hypot(u, v);
  const double radius = std::sqrt(domain.limits[0]);
  if (!(distorted < kSlack * domain.max_radius)) return false;
  const bool surely_inside = kSlack * distorted < domain.limits[1];
  if (!surely_inside && !ImageOfDiscContains(map, radius, u, v)) return false;
  // The first guess: as far out as the image, well inside the disc.
  constexpr double kInside = 0.95;
  const double start = distorted > kInside * radius ? kInside * radius / distorted : 1.0;
  *x = start * u;
  *y = start * v;
  return InvertPlaneMap(map, radius, u, v, x, y);
}

void Direction(PlaneChart chart, double x, double y, double* ray) {
  const double radius = std::hypot(x, y);
  const double angle = AngleOf(chart, radius);
  const double over = radius > 0.0 ? std::sin(angle) / radius : 0.0;
  ray[0] = over * x;
  ray[1] = over * y;
  ray[2] = std::cos(angle);
}

}  // namespace

LensDomain PlaneChartDomain(PlaneChart chart, const double* params, const PlaneMap& distortion,
                            double angle_limit) {
  double center[2];
  const PlaneMap map = Centred(distortion, center);
  const double largest = LargestDistortedRadius(params);
  double radius = RegularRadius(map, LargestRadius(chart, params));
  radius = RadiusWithin(map, radius, largest);
  radius = std::min(radius, RadiusOf(chart, angle_limit));
  LensDomain domain;
  SetCone(std::min(AngleOf(chart, radius), angle_limit), &domain);
  const ImageRadii image = ImageOfCircle(map, radius);
  domain.max_radius = image.largest;
  domain.limits[0] = radius * radius;
  domain.limits[1] = image.smallest;
  return domain;
}

bool UnprojectPlaneChart(PlaneChart chart, const LensDomain& domain, const double* params,
                         const PlaneMap& distortion, double u, double v, double* ray) {
  double center[2], target_u = 0.0, target_v = 0.0, x = 0.0, y = 0.0;
  const PlaneMap map = Centred(distortion, center);
  if (!FromPixel(params, u, v, &target_u, &target_v)) return false;
  if (!Undistort(domain, map, target_u - center[0], target_v - center[1], &x, &y)) return false;
  if (!(x * x + y * y < domain.limits[0])) return false;
  // The round trip, with the gain from an error in the plane to one in pixels.
  const PlanePoint back = distortion(x, y);
  const double gain_u = params[0] * std::hypot(back.du_dx, back.du_dy);
  const double gain_v = params[1] * std::hypot(back.dv_dx, back.dv_dy);
  const double gain = std::hypot(x, y) * std::hypot(gain_u, gain_v);
  const double back_u = params[0] * back.u + params[2];
  const double back_v = params[1] * back.v + params[3];
  if (!InverseConverged(u, v, back_u, back_v, gain)) return false;
  Direction(chart, x, y, ray);
  return true;
}

// --- The radial-tangential lenses (OpenCV 4, 5, 8, 12, 14 coefficients) ---

namespace {

constexpr int kMaxCoefficients = 14;

// The coefficients, zero where the lens has none.
struct Coefficients {
  std::array<double, kMaxCoefficients> c = {};
  bool is_radial = true;
  bool has_tilt = false;

  Coefficients(const double* params, int num_params) {
    std::copy(params + 4, params + num_params, c.begin());
    has_tilt = c[12] != 0.0 || c[13] != 0.0;
    is_radial = c[2] == 0.0 && c[3] == 0.0 && !has_tilt &&
                std::all_of(c.begin() + 8, c.begin() + 12, [](double s) { return s == 0.0; });
  }
  // g(r^2) = numerator / denominator, both as polynomials in r^2.
  std::array<double, 4> Numerator() const { return {1.0, c[0], c[1], c[4]}; }
  std::array<double, 4> Denominator() const { return {1.0, c[5], c[6], c[7]}; }
};

std::vector<double> Product(std::span<const double> a, std::span<const double> b) {
  std::vector<double> product(a.size() + b.size() - 1, 0.0);
  for (std::size_t i = 0; i < a.size(); ++i) {
    for (std::size_t j = 0; j < b.size(); ++j) product[i + j] += a[i] * b[j];
  }
  return product;
}

// s p'(s): the coefficients times their powers.
std::array<double, 4> TimesPower(const std::array<double, 4>& p) {
  return {0.0, p[1], 2.0 * p[2], 3.0 * p[3]};
}

// The first radius where r g(r^2) stops rising or has a pole.
double RadialLimit(const Coefficients& k) {
  const auto n = k.Numerator();
  const auto d = k.Denominator();
  // With s = r^2: d(r n/d)/dr = ((n + 2 s n') d - n 2 s d') / d^2.
  std::vector<double> slope = Product(n, d);
  const std::vector<double> rising = Product(TimesPower(n), d);
  const std::vector<double> falling = Product(n, TimesPower(d));
  for (std::size_t i = 0; i < slope.size(); ++i) slope[i] += 2.0 * (rising[i] - falling[i]);
  return std::sqrt(std::min(SmallestPositiveRoot(slope), SmallestPositiveRoot(d)));
}

// r g(r^2) and its derivative.
double DistortRadius(const Coefficients& k, double r, double* derivative) {
  const auto n = k.Numerator();
  const auto d = k.Denominator();
  const double s = r * r;
  const double at_n = EvaluatePolynomial(n, s);
  const double at_d = EvaluatePolynomial(d, s);
  const double g = at_n / at_d;
  if (derivative != nullptr) {
    const double n_power = EvaluatePolynomial(TimesPower(n), s);
    const double d_power = EvaluatePolynomial(TimesPower(d), s);
    *derivative = g + 2.0 * (n_power - g * d_power) / at_d;
  }
  return r * g;
}

// The whole distortion with its Jacobian.
// Duals of two directions give the Jacobian; terms that are all zero are not computed.
PlaneMap MakePlaneMap(const Coefficients& k) {
  return gsut::MakePlaneMap([&k](const Dual<2>& x, const Dual<2>& y, Dual<2>* u, Dual<2>* v) {
    if (k.has_tilt) {
      lenses::RadialTangential<14>::Distort(k.c.data(), x, y, u, v);
    } else {
      lenses::RadialTangential<12>::Distort(k.c.data(), x, y, u, v);
    }
  });
}

// The radius <= `radius`, inside which the radial part rises, that it takes to `distorted`.
double InvertRadius(const Coefficients& k, double radius, double distorted) {
  const auto f = [&k](double r, double* derivative) { return DistortRadius(k, r, derivative); };
  return SolveIncreasing(f, distorted, 0.0, radius, distorted);
}

// The part of a disc inside which the radial part rises (without end if radius is infinite) that it
// keeps within `largest`.
double CutRadius(const Coefficients& k, double radius, double largest) {
  if (!std::isfinite(radius)) {
    radius = 1.0;
    while (DistortRadius(k, radius, nullptr) < largest) radius *= 2.0;
  }
  const double at_end = DistortRadius(k, radius, nullptr);
  // At a pole the quotient is anything huge, of either sign.
  return at_end > 0.0 && at_end < largest ? radius : InvertRadius(k, radius, largest);
}

// Without tangential and thin-prism terms and tilt only the radius changes: one equation in one
// unknown. Otherwise two, from a start that ignores all but the radial part.
// (u, v) in focal lengths -> (x, y) in the disc of this radius.
bool Undistort(const LensDomain& domain, const Coefficients& k, double u, double v, double* x,
               double* y) {
  const double distorted = std::hypot(u, v);
  if (distorted == 0.0) {
    *x = *y = 0.0;
    return true;
  }
  const double radius = std::sqrt(domain.limits[0]);
  if (k.is_radial) {
    if (!(distorted < domain.max_radius)) return false;
    const double r = InvertRadius(k, radius, distorted);
    *x = u * (r / distorted);
    *y = v * (r / distorted);
    return true;
  }
  // Should the sampling of the two radii have missed a little.
  constexpr double kSlack = 1.02;
  const PlaneMap map = MakePlaneMap(k);
  if (!(distorted < kSlack * domain.max_radius)) return false;
  const bool surely_inside = kSlack * distorted < domain.limits[1];
  if (!surely_inside && !ImageOfDiscContains(map, radius, u, v)) return false;
  // The radial part alone is the first guess, well inside the disc.
  constexpr double kInside = 0.95;
  const double inside = kInside * radius;
  const bool reached = DistortRadius(k, inside, nullptr) <= distorted;
  const double start = reached ? inside : InvertRadius(k, inside, distorted);
  *x = u * (start / distorted);
  *y = v * (start / distorted);
  return InvertPlaneMap(map, radius, u, v, x, y);
}

}  // namespace

LensDomain RadialTangentialDomain(const double* params, int num_params, double angle_limit) {
  const Coefficients k(params, num_params);
  const PlaneMap map = MakePlaneMap(k);
  const double largest = LargestDistortedRadius(params);
  // The radial part gives a first bound, the other terms can only shrink it.
  double radius = CutRadius(k, RadialLimit(k), largest);
  if (!k.is_radial) radius = RadiusWithin(map, RegularRadius(map, radius), largest);
  // std::tan is finite and positive just below 90 degrees.
  if (angle_limit < 0.5 * kPi) radius = std::min(radius, std::tan(angle_limit));
  LensDomain domain;
  domain.max_angle = std::atan(radius);
  if (k.is_radial) {
    domain.max_radius = domain.limits[1] = DistortRadius(k, radius, nullptr);
  } else {
    const ImageRadii image = ImageOfCircle(map, radius);
    domain.max_radius = image.largest;
    domain.limits[1] = image.smallest;
  }
  domain.limits[0] = radius * radius;
  return domain;
}

bool UnprojectRadialTangential(const LensDomain& domain, const double* params, int num_params,
                               double u, double v, double* ray) {
  double target_u = 0.0, target_v = 0.0, x = 0.0, y = 0.0;
  if (!FromPixel(params, u, v, &target_u, &target_v)) return false;
  const Coefficients k(params, num_params);
  if (!Undistort(domain, k, target_u, target_v, &x, &y)) return false;
  if (!(x * x + y * y < domain.limits[0])) return false;
  const PlanePoint back = MakePlaneMap(k)(x, y);
  const double gain_u = params[0] * std::hypot(back.du_dx, back.du_dy);
  const double gain_v = params[1] * std::hypot(back.dv_dx, back.dv_dy);
  const double gain = std::hypot(x, y) * std::hypot(gain_u, gain_v);
  const double back_u = params[0] * back.u + params[2];
  const double back_v = params[1] * back.v + params[3];
  if (!InverseConverged(u, v, back_u, back_v, gain)) return false;
  const double norm = std::sqrt(1.0 + x * x + y * y);
  ray[0] = x / norm;
  ray[1] = y / norm;
  ray[2] = 1.0 / norm;
  return true;
}

// --- The splined lens: parameters, and its surface as a map of the plane ---

namespace {

using lenses::SplinedStereographic;
using lenses::StarEdge;

// The largest radius of the plane that is looked at: 168.6 degrees.
constexpr double kLargestRadius = 20.0;

// (x, y) -> (x', y') - offset, with the image of the origin as offset.
// The spline shifts points of the stereographic plane; this is the map with its derivatives. Its
// domain is star-shaped about the origin: one radius a sector of directions, up to the first fold
// in it.
struct Surface {
  const double* params;
  double density;
  double offset[2];

  explicit Surface(const double* p) : params(p), density(SplineDensity(p)), offset{0.0, 0.0} {
    const PlanePoint origin = (*this)(0.0, 0.0);
    offset[0] = origin.u;
    offset[1] = origin.v;
  }
  PlanePoint operator()(double x, double y) const {
    double value[2], dx[2], dy[2];
    SplinedStereographic::Spline(params, density, x, y, value, dx, dy);
    return {
        x + value[0] - offset[0], y + value[1] - offset[1], 1.0 + dx[0], dy[0], dx[1], 1.0 + dy[1]};
  }
};

// The direction (x, y) of a place around the square of diamond angles, in sectors.
// Sectors are even in diamond angles (star_edge.h): no arctangent on the way back.
void DirectionOf(double sector, double* x, double* y) {
  const double around = 4.0 * sector / StarEdge::kSectors - 2.0;
  *x = 1.0 - std::abs(around);
  *y = around < -1.0 ? -2.0 - around : around > 1.0 ? 2.0 - around : around;
  const double norm = std::hypot(*x, *y);
  *x /= norm;
  *y /= norm;
}

// The map turns forward at this point: no fold, and once around the image of the origin.
bool IsRegular(const PlanePoint& p, double x, double y) {
  const double du = -p.du_dx * y + p.du_dy * x;
  const double dv = -p.dv_dx * y + p.dv_dy * x;
  return p.du_dx * p.dv_dy - p.du_dy * p.dv_dx > 0.0 && p.u * dv - p.v * du > 0.0;
}

// The first radius in this direction where the map is not regular.
double FirstFold(const Surface& surface, double direction_x, double direction_y) {
  // The outermost control points end the lens: what lies beyond is extrapolated, and soon folds.
  const double half_x = 0.5 * (surface.params[1] - 1.0) / surface.density;
  const double half_y = 0.5 * (surface.params[2] - 1.0) / surface.density;
  const double end =
      std::min({kLargestRadius, half_x / std::abs(direction_x), half_y / std::abs(direction_y)});
  // Of the distance of control points: a cubic between them cannot fold and unfold in less.
  constexpr double kStep = 0.25;
  const double step = kStep / surface.density;
  const auto regular = [&](double r) {
    return IsRegular(surface(r * direction_x, r * direction_y), r * direction_x, r * direction_y);
  };
  double good = 0.0;
  while (good < end) {
    const double next = std::min(good + step, end);
    if (regular(next)) {
      good = next;
      continue;
    }
    // Halvings of a quarter of a cell leave 1e-10 of it.
    double bad = next;
    constexpr int kHalvings = 30;
    for (int i = 0; i < kHalvings; ++i) {
      const double middle = 0.5 * (good + bad);
      (regular(middle) ? good : bad) = middle;
    }
    break;
  }
  return good;
}

}  // namespace

void CheckSplineParams(const char* lens, const double* params, int num_params) {
  constexpr double kMostPoints = 2000;  // in a row or column
  const double order = params[0], count_x = params[1], count_y = params[2], fov = params[3];
  std::ostringstream message;
  message << lens << ": ";
  if (order != 2.0 && order != 3.0) {
    message << "order is " << order << "; it must be 2 or 3";
    throw InputError(message.str());
  }
  for (const double count : {count_x, count_y}) {
    if (count >= order + 1.0 && count <= kMostPoints && count == std::floor(count)) continue;
    message << "Nx, Ny are " << count_x << ", " << count_y
            << "; they must be whole numbers from order + 1 to " << kMostPoints;
    throw InputError(message.str());
  }
  constexpr int kFixedParams = SplinedStereographic::kPoints;  // before the control points
  const int wanted = kFixedParams + 2 * static_cast<int>(count_x) * static_cast<int>(count_y);
  if (num_params != wanted) {
    message << "Nx Ny 2 + 8 = " << wanted << " values are needed, found " << num_params;
    throw InputError(message.str());
  }
  constexpr double kSmallestFov = 1e-3;  // degrees: the density of control points stays finite
  constexpr double kLargestFov = 359.0;  // degrees: 360 lies at infinity in the stereographic plane
  CheckLensParam(lens, "fov_x_degrees", fov, kSmallestFov, kLargestFov);
  CheckFocalParams(lens, "fx fy cx cy control_points ...", params + 4, num_params - 4);
}

// Nx - order intervals span fov_x, whose half has the radius 2 tan(fov / 4) in the plane.
double SplineDensity(const double* params) {
  constexpr double kRadians = kPi / 180.0;
  return (params[1] - params[0]) / (4.0 * std::tan(0.25 * kRadians * params[3]));
}

LensDomain SplineDomain(const double* params, double angle_limit) {
  const Surface surface(params);
  // Each sector ends before the folds on its sides and in its middle, less what they may miss.
  constexpr double kMargin = 1e-3;
  std::vector<double> fold(2 * StarEdge::kSectors);
  for (std::size_t i = 0; i < fold.size(); ++i) {
    double x = 0.0, y = 0.0;
    DirectionOf(0.5 * static_cast<double>(i), &x, &y);
    fold[i] = FirstFold(surface, x, y);
  }
  // Squared radii in float, as kernels compare them.
  auto edge = std::make_shared<std::vector<float>>(StarEdge::kSectors);
  double farthest = 0.0;
  for (std::size_t i = 0; i < edge->size(); ++i) {
    const double after = fold[(2 * i + 2) % fold.size()];
    const double radius = (1.0 - kMargin) * std::min({fold[2 * i], fold[2 * i + 1], after});
    (*edge)[i] = static_cast<float>(radius * radius);
    farthest = std::max(farthest, radius);
  }
  LensDomain domain;
  SetCone(std::min(angle_limit, 2.0 * std::atan(0.5 * farthest)), &domain);
  domain.max_radius = farthest;
  domain.limits[2] = surface.density;
  domain.edge = std::move(edge);
  return domain;
}

bool UnprojectSpline(const LensDomain& domain, const double* params, double u, double v,
                     double* ray) {
  const double* focal = params + SplinedStereographic::kFocal;
  const Surface surface(params);
  double image_x = 0.0, image_y = 0.0;
  if (!FromPixel(focal, u, v, &image_x, &image_y)) return false;
  image_x -= surface.offset[0];
  image_y -= surface.offset[1];
  // From where the undistorted lens sees the pixel, no farther than the farthest edge.
  const double distance = std::hypot(image_x, image_y);
  constexpr double kInside = 0.95;  // of the farthest edge
  const double start =
      distance > kInside * domain.max_radius ? kInside * domain.max_radius / distance : 1.0;
  double x = start * image_x, y = start * image_y;
  if (!InvertPlaneMap(surface, domain.max_radius, image_x, image_y, &x, &y)) return false;
  if (!lenses::StarEdge::Contains(domain, x, y)) return false;
  // The round trip in pixels decides.
  const PlanePoint back = surface(x, y);
  const double back_u = focal[0] * (back.u + surface.offset[0]) + focal[2];
  const double back_v = focal[1] * (back.v + surface.offset[1]) + focal[3];
  const double gain = std::max(focal[0], focal[1]) * distance;
  if (!InverseConverged(u, v, back_u, back_v, gain)) return false;
  return RayInCone(domain, x, y, 1.0 - 0.25 * (x * x + y * y), ray);
}

}  // namespace gsut
