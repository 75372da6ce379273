// Domain and inverse of lenses that map directions to a plane, and then distort that plane.
#include "gsut/cameras/plane_chart.h"

#include <algorithm>
#include <cmath>

#include "gsut/cameras/contract.h"

namespace gsut {
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

}  // namespace gsut
