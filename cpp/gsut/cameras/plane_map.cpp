// Domain and inverse of a smooth map of the plane: lenses that are not symmetric about the axis.
#include "gsut/cameras/plane_map.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <vector>

namespace gsut {
namespace {

constexpr int kAzimuths = 64;
constexpr int kRadii = 256;
constexpr double kTwoPi = 6.283185307179586477;
// The domain stops this far (relative) before the singular circle.
constexpr double kMargin = 1e-9;
constexpr double kEpsilon = std::numeric_limits<double>::epsilon();

// Positive where the map keeps orientation.
double Determinant(const PlanePoint& p) { return p.du_dx * p.dv_dy - p.du_dy * p.dv_dx; }

PlanePoint OnCircle(const PlaneMap& map, double radius, double azimuth) {
  return map(radius * std::cos(azimuth), radius * std::sin(azimuth));
}

// Regular where the map keeps orientation (its Jacobian's determinant is positive) and the image of
// a circle turns forward about the centre: a disc of such points is mapped one-to-one.
bool IsRegular(const PlaneMap& map, double x, double y) {
  const PlanePoint p = map(x, y);
  const double du = -p.du_dx * y + p.du_dy * x;  // along the circle
  const double dv = -p.dv_dx * y + p.dv_dy * x;
  return Determinant(p) > 0.0 && p.u * dv - p.v * du > 0.0;  // false for NaN
}

double Azimuth(int sample) { return kTwoPi * sample / kAzimuths; }

// The smallest value of f found by golden section between the neighbours of a sampled azimuth.
double MinimumNear(int sample, const std::function<double(double azimuth)>& f) {
  constexpr double kGolden = 0.6180339887498949;
  constexpr int kSteps = 40;  // 0.6^40 of the interval: 1e-9 rad
  double low = Azimuth(sample - 1);
  double high = Azimuth(sample + 1);
  double inner_low = high - kGolden * (high - low);
  double inner_high = low + kGolden * (high - low);
  double at_low = f(inner_low);
  double at_high = f(inner_high);
  double smallest = std::min(at_low, at_high);
  for (int i = 0; i < kSteps; ++i) {
    if (at_low < at_high) {
      high = inner_high;
      inner_high = inner_low;
      at_high = at_low;
      inner_low = high - kGolden * (high - low);
      at_low = f(inner_low);
    } else {
      low = inner_low;
      inner_low = inner_high;
      at_low = at_high;
      inner_high = low + kGolden * (high - low);
      at_high = f(inner_high);
    }
    smallest = std::min({smallest, at_low, at_high});
  }
  return smallest;
}

// Even steps of the angle whose tangent they are: dense where images are, sparse far out.
// Radii to look at, ascending, the last one being the limit.
std::vector<double> SampleRadii(double limit) {
  std::vector<double> radii;
  const double limit_angle = std::atan(limit);
  for (int i = 1; i < kRadii; ++i) radii.push_back(std::tan(limit_angle * i / kRadii));
  constexpr double kLargestGrowth = 1.25;
  while (kLargestGrowth * radii.back() < limit) radii.push_back(kLargestGrowth * radii.back());
  radii.push_back(limit);
  return radii;
}

// The first radius at this azimuth where the map stops being regular; limit if it never does. Radii
// up to `good` are regular.
double FirstSingularRadius(const PlaneMap& map, std::span<const double> radii, double azimuth,
                           double limit, double good) {
  const double along_x = std::cos(azimuth), along_y = std::sin(azimuth);
  const auto is_regular = [&](double radius) {
    return IsRegular(map, radius * along_x, radius * along_y);
  };
  for (const double radius : radii) {
    if (good >= limit) break;
    if (is_regular(radius)) {
      good = radius;
      continue;
    }
    // Bisection down to neighbouring numbers.
    double bad = radius;
    for (;;) {
      const double middle = 0.5 * (good + bad);
      if (!(middle > good && middle < bad)) return std::min(good, limit);
      (is_regular(middle) ? good : bad) = middle;
    }
  }
  return limit;
}

// One Newton step towards (u, v); false if the Jacobian is singular or turned over.
bool NewtonStep(const PlanePoint& p, double u, double v, double* dx, double* dy) {
  const double determinant = Determinant(p);
  if (!(determinant > 0.0)) return false;
  const double eu = u - p.u;
  const double ev = v - p.v;
  *dx = (p.dv_dy * eu - p.du_dy * ev) / determinant;
  *dy = (p.du_dx * ev - p.dv_dx * eu) / determinant;
  return true;
}

// Damped Newton inside the disc. True if it ends where rounding ends it.
bool Newton(const PlaneMap& map, double radius, double u, double v, int max_steps, double* x,
            double* y) {
  PlanePoint p = map(*x, *y);
  double residual = std::hypot(u - p.u, v - p.v);
  // Rounding of the map's result, in units in the last place of its intermediate values, and the
  // multiple of it that is accepted where no step improves on it.
  constexpr double kRounding = 4.0;
  constexpr double kAccepted = 16.0;
  const double rounding = kRounding * kEpsilon * (1.0 + std::hypot(u, v));
  const double accepted = kAccepted * rounding;
  for (int i = 0; i < max_steps; ++i) {
    if (residual <= rounding) return true;
    double dx = 0.0, dy = 0.0;
    if (!NewtonStep(p, u, v, &dx, &dy)) return false;
    // Next to a pole the rounding of (x, y) alone moves the image by more than `accepted`.
    const bool at_floor =
        residual <= accepted || std::hypot(dx, dy) <= kAccepted * kEpsilon * std::hypot(*x, *y);
    // Halve the step until it stays in the disc, keeps orientation and lowers the residual.
    double scale = 1.0;
    for (;; scale *= 0.5) {
      constexpr double kSmallestScale = 1e-4;
      // A full step that does not help: at the rounding floor that is success.
      if (scale < 1.0 && at_floor) return true;
      if (scale < kSmallestScale) return false;
      const double next_x = *x + scale * dx;
      const double next_y = *y + scale * dy;
      if (!(std::hypot(next_x, next_y) < radius)) continue;
      const PlanePoint next = map(next_x, next_y);
      const double next_residual = std::hypot(u - next.u, v - next.v);
      if (!(Determinant(next) > 0.0) || !(next_residual < residual)) continue;
      *x = next_x;
      *y = next_y;
      p = next;
      residual = next_residual;
      break;
    }
  }
  return residual <= accepted;
}

}  // namespace

// Azimuths are sampled, and the worst one is refined between its neighbours.
double RegularRadius(const PlaneMap& map, double limit,
                     const std::function<bool(double radius)>& is_sure) {
  const std::vector<double> all = SampleRadii(limit);
  std::size_t known = 0;
  while (is_sure && known < all.size() && is_sure(all[known])) ++known;
  const std::span<const double> radii = std::span(all).subspan(known);
  const double good = known == 0 ? 0.0 : all[known - 1];
  double smallest = limit;
  int worst = -1;
  for (int i = 0; i < kAzimuths; ++i) {
    const double found = FirstSingularRadius(map, radii, Azimuth(i), smallest, good);
    if (found < smallest) {
      smallest = found;
      worst = i;
    }
  }
  if (worst < 0) return limit;
  // The margin keeps the domain's own points regular, to rounding.
  const double refined = MinimumNear(
      worst, [&](double azimuth) { return FirstSingularRadius(map, radii, azimuth, limit, good); });
  return std::min(smallest, refined) * (1.0 - kMargin);
}

// The smallest and largest distance of the circle's image from the centre bound where inverses can
// be.
ImageRadii ImageOfCircle(const PlaneMap& map, double radius) {
  const auto image_radius = [&](double azimuth) {
    const PlanePoint p = OnCircle(map, radius, azimuth);
    return std::hypot(p.u, p.v);
  };
  ImageRadii radii = {std::numeric_limits<double>::infinity(), 0.0};
  int nearest = 0, farthest = 0;
  for (int i = 0; i < kAzimuths; ++i) {
    const double found = image_radius(Azimuth(i));
    if (found < radii.smallest) {
      radii.smallest = found;
      nearest = i;
    }
    if (found > radii.largest) {
      radii.largest = found;
      farthest = i;
    }
  }
  radii.smallest = std::min(radii.smallest, MinimumNear(nearest, image_radius));
  const double far = -MinimumNear(farthest, [&](double azimuth) { return -image_radius(azimuth); });
  radii.largest = std::max(radii.largest, far);
  return radii;
}

// The image grows with the disc, so bisection finds where it reaches `largest`.
double RadiusWithin(const PlaneMap& map, double radius, double largest) {
  if (ImageOfCircle(map, radius).largest < largest) return radius;
  constexpr double kPrecision = 1e-9;
  double low = 0.0, high = radius;
  while (high - low > kPrecision * high) {
    const double middle = 0.5 * (low + high);
    (ImageOfCircle(map, middle).largest < largest ? low : high) = middle;
  }
  return low;
}

// The boundary's image turns forward once, so exactly one of its points lies in the target's
// direction: is it farther out than the target?
bool ImageOfDiscContains(const PlaneMap& map, double radius, double u, double v) {
  // The side of the target on which the image of a boundary point lies.
  const auto turn = [&](double azimuth) {
    const PlanePoint p = OnCircle(map, radius, azimuth);
    return u * p.v - v * p.u;
  };
  constexpr double kReach = kTwoPi / 8;  // no lens turns a direction further
  const double direction = std::atan2(v, u);
  // The turn rises with the azimuth, so bisection finds where it is zero.
  double low = direction - kReach, high = direction + kReach;
  if (!(turn(low) < 0.0 && turn(high) > 0.0)) return true;  // undecided: let Newton decide
  for (;;) {
    const double middle = 0.5 * (low + high);
    if (!(middle > low && middle < high)) break;
    (turn(middle) < 0.0 ? low : high) = middle;
  }
  const PlanePoint boundary = OnCircle(map, radius, low);
  return std::hypot(u, v) < std::hypot(boundary.u, boundary.v);
}

bool InvertPlaneMap(const PlaneMap& map, double radius, double u, double v, double* x, double* y) {
  constexpr int kDirectSteps = 30;           // from the caller's start: nearly always enough
  constexpr int kCorrectorSteps = 12;        // from the last point of the path, which is near
  constexpr double kFirstAdvance = 0.125;    // of the path; doubled after each success
  constexpr double kSmallestAdvance = 1e-5;  // of the path: below it, the path ends at a fold
  if (Newton(map, radius, u, v, kDirectSteps, x, y)) return true;
  // Homotopy: (0, 0) solves map(x, y) = t (u, v) at t = 0, and each t starts where the last ended.
  double t = 0.0, advance = kFirstAdvance;
  double px = 0.0, py = 0.0;
  while (t < 1.0) {
    const double next = std::min(1.0, t + advance);
    double cx = px, cy = py;
    if (Newton(map, radius, next * u, next * v, kCorrectorSteps, &cx, &cy)) {
      px = cx;
      py = cy;
      t = next;
      advance *= 2.0;
    } else {
      advance *= 0.5;
      if (advance < kSmallestAdvance) return false;
    }
  }
  *x = px;
  *y = py;
  return true;
}

}  // namespace gsut
