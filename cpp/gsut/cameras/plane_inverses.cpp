// Domains and inverses of lenses that distort a plane of directions.
#include "gsut/cameras/plane_inverses.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <vector>

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
  bool is_plain = true;  // polynomial and tangential terms alone
  bool has_tilt = false;

  Coefficients(const double* params, int num_params) {
    std::copy(params + 4, params + num_params, c.begin());
    const auto are_none = [this](int first, int last) {
      return std::all_of(c.begin() + first, c.begin() + last, [](double s) { return s == 0.0; });
    };
    has_tilt = !are_none(12, 14);
    is_radial = are_none(2, 4) && are_none(8, 14);
    is_plain = are_none(5, 14);
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
    } else if (k.is_plain) {
      lenses::RadialTangential<5>::Distort(k.c.data(), x, y, u, v);
    } else {
      lenses::RadialTangential<12>::Distort(k.c.data(), x, y, u, v);
    }
  });
}

// Whether the map of a lens without tilt is regular all along the circle of this radius, as far as
// bounds say. There the radial part's Jacobian is symmetric with eigenvalues g (along the circle)
// and slope = d(r g)/dr. With p = (p2, p1), q = (s1, s3), q' = (s2, s4) the other terms are
//   t(x) = r2 p + 2 (p.x) x + r2 q + r2^2 q',   |t| <= r2 (3 |p| + |q| + r2 |q'|),
//   dt/dx = 2 p x' + 2 x p' + 2 (p.x) I + 2 (q + 2 r2 q') x',   |dt/dx| <= 6 |p| r + ... = turn.
// While turn < min(g, slope) no part of it makes the Jacobian singular, so its determinant stays
// positive; and the cross product of the image with its derivative along the circle is at least
// r (r g (g - turn) - |t| (g + turn)).
bool IsSurelyRegular(const Coefficients& k, double r) {
  constexpr double kSafety = 1.001;  // far above rounding, as is the next
  constexpr double kSmall = 1e-6;
  double slope = 0.0;
  const double g = DistortRadius(k, r, &slope) / r;
  const double p = std::hypot(k.c[2], k.c[3]);
  const double q = std::hypot(k.c[8], k.c[10]), q2 = r * r * std::hypot(k.c[9], k.c[11]);
  const double moved = kSafety * r * r * (3.0 * p + q + q2);
  const double turn = kSafety * r * (6.0 * p + 2.0 * q + 4.0 * q2);
  return turn + kSmall * g < std::min(g, slope) && moved * (g + turn) < r * g * (g - turn);
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
  if (!k.is_radial) {
    const auto is_sure = [&k](double r) { return !k.has_tilt && IsSurelyRegular(k, r); };
    radius = RadiusWithin(map, RegularRadius(map, radius, is_sure), largest);
  }
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

}  // namespace gsut
