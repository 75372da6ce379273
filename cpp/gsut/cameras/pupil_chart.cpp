// Domain and inverse of cahvore, in double.
#include "gsut/cameras/pupil_chart.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "gsut/base/errors.h"
#include "gsut/cameras/contract.h"

namespace gsut {
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
