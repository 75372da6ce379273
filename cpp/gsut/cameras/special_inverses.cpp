// Domains and inverses of two lenses with formulas of their own: the splined one and cahvore.
#include "gsut/cameras/special_inverses.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <sstream>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/cameras/plane_map.h"
#include "gsut/cameras/visit_lens.h"

namespace gsut {

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

// --- Cahvore ---

namespace {

// CAHVORE's entrance pupil moves along the optical axis with the angle theta of a ray, so rays do
// not meet. With chi(theta) by the linearity L (tan(L theta) / L, theta, or sin(L theta) / L), the
// pixel shows the tangent  chi (1 + r0 + r1 chi^2 + r2 chi^4). From pixel to ray all is explicit
// but the root of that polynomial; from point to pixel the pupil depends on the angle, and Project
// iterates.

constexpr double kLargestTilt = 0.5;    // of the optical axis, radians
constexpr int kDomainSamples = 4096;    // of the angle, to find the first fold
constexpr double kDomainMargin = 1e-9;  // relative: before the fold
constexpr int kMaxSteps = 100;          // of bisection, more than a double has digits

struct Chart {
  const double* params;

  double Linearity() const { return params[12]; }
  // chi of an angle, and back.
  double Chi(double theta) const {
    const double l = Linearity();
    return l > 0 ? std::tan(l * theta) / l : l < 0 ? std::sin(l * theta) / l : theta;
  }
  double Angle(double chi) const {
    const double l = Linearity();
    return l > 0 ? std::atan(l * chi) / l : l < 0 ? std::asin(l * chi) / l : chi;
  }
  // Tangent of the angle that the pixel shows, and its slope.
  double Tangent(double chi) const {
    const double c2 = chi * chi;
    return chi * (1.0 + params[6] + c2 * (params[7] + c2 * params[8]));
  }
  double Slope(double chi) const {
    const double c2 = chi * chi;
    return 1.0 + params[6] + c2 * (3.0 * params[7] + c2 * 5.0 * params[8]);
  }
};

// The unit vector that two tilts of the camera's axis give.
void OpticalAxis(const double* params, double* axis) {
  axis[0] = std::sin(params[4]) * std::cos(params[5]);
  axis[1] = std::sin(params[5]);
  axis[2] = std::cos(params[4]) * std::cos(params[5]);
}

}  // namespace

LensDomain PupilChartDomain(const double* params, double angle_limit) {
  for (int i = 4; i < 6; ++i) {
    if (std::abs(params[i]) <= kLargestTilt) continue;
    std::ostringstream message;
    message << "cahvore: " << (i == 4 ? "alpha" : "beta") << " is " << params[i]
            << "; the optical axis may be tilted by at most " << kLargestTilt << " radians";
    throw InputError(message.str());
  }
  const Chart chart{params};
  if (!(std::abs(chart.Linearity()) <= 1.0)) {
    std::ostringstream message;
    message << "cahvore: linearity is " << chart.Linearity() << "; it must lie in [-1, 1]";
    throw InputError(message.str());
  }
  double limit = std::min(angle_limit, kPi);
  if (chart.Linearity() != 0.0) {
    limit = std::min(limit, 0.5 * kPi / std::abs(chart.Linearity()) * (1.0 - kDomainMargin));
  }
  const double largest = LargestDistortedRadius(params);
  const auto rises = [&](double theta) {
    const double chi = chart.Chi(theta);
    return chart.Slope(chi) > 0.0 && chart.Tangent(chi) < largest;
  };
  if (!rises(0.0)) {
    throw InputError("cahvore: 1 + r0 is not positive: the lens has no image on its axis");
  }
  // The first angle, from the axis, at which the tangent stops rising.
  double inside = 0.0, outside = limit;
  for (int i = 1; i <= kDomainSamples; ++i) {
    const double theta = limit * i / kDomainSamples;
    if (!rises(theta)) {
      outside = theta;
      for (int step = 0; step < kMaxSteps; ++step) {
        const double middle = 0.5 * (inside + outside);
        (rises(middle) ? inside : outside) = middle;
      }
      break;
    }
    inside = theta;
  }
  double axis[3];
  OpticalAxis(params, axis);
  LensDomain domain;
  domain.limits[0] = inside * (1.0 - kDomainMargin);
  domain.max_angle = std::min(kPi, domain.limits[0] + std::acos(std::min(axis[2], 1.0)));
  domain.max_radius = chart.Tangent(chart.Chi(domain.limits[0]));
  return domain;
}

bool UnprojectPupilChart(const LensDomain& domain, const double* params, double u, double v,
                         double* origin, double* ray) {
  double direction[3] = {0.0, 0.0, 1.0};
  if (!FromPixel(params, u, v, &direction[0], &direction[1])) return false;
  // The pixel's direction, in parts along and across the optical axis.
  const Chart chart{params};
  double axis[3], across[3];
  OpticalAxis(params, axis);
  const double along = direction[0] * axis[0] + direction[1] * axis[1] + direction[2] * axis[2];
  for (int k = 0; k < 3; ++k) across[k] = direction[k] - along * axis[k];
  const double length = std::hypot(across[0], across[1], across[2]);
  const double tangent = length / along;
  double high = chart.Chi(domain.limits[0]);
  if (!(along > 0.0) || !(tangent <= chart.Tangent(high))) return false;
  // The root of Tangent(chi) = tangent, by Newton inside a bracket.
  double low = 0.0, chi = std::min(tangent, high);
  for (int step = 0; step < kMaxSteps; ++step) {
    const double error = chart.Tangent(chi) - tangent;
    (error > 0.0 ? high : low) = chi;
    double next = chi - error / chart.Slope(chi);
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (next == chi || high - low <= 0.0) break;
    chi = next;
  }
  const double theta = chart.Angle(chi);
  const double sine = std::sin(theta), cosine = std::cos(theta), theta2 = theta * theta;
  // theta / sin(theta) - 1 cancels for small angles: its series is theta^2 / 6.
  constexpr double kSmallAngle = 1e-4;
  const double late = theta < kSmallAngle ? theta2 / 6.0 : theta / sine - 1.0;
  const double pupil = late * (params[9] + theta2 * (params[10] + theta2 * params[11]));
  for (int k = 0; k < 3; ++k) {
    origin[k] = pupil * axis[k];
    ray[k] = cosine * axis[k] + (length > 0.0 ? sine / length * across[k] : 0.0);
  }
  return true;
}

}  // namespace gsut
