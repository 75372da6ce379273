// Domain and inverse of the f-theta lens.
#include "gsut/cameras/ftheta_map.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <sstream>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/cameras/visit_lens.h"
#include "gsut/cameras/polynomial.h"

namespace gsut {
namespace {

using lenses::Ftheta;

// The lens has two polynomials: B from pixels to angles, A from angles to pixels. One of them, the
// reference, is the lens; the other is its approximate inverse and only starts Newton's steps.
bool IsAngleToPixel(const double* params) { return params[Ftheta::kReference] > 0.5; }

// The exact polynomial.
std::span<const double> Reference(const double* params) {
  return {params + (IsAngleToPixel(params) ? Ftheta::kA : Ftheta::kB),
          static_cast<std::size_t>(Ftheta::kDegree + 1)};
}

// Where the polynomial, increasing on [0, high], takes this value.
// Newton inside a bracket, on t times the polynomial over t, as t = 0 is a root of all of them.
double Solve(std::span<const double> p, double value, double high, double start) {
  const auto f = [p](double t, double* derivative) {
    *derivative = Ftheta::Slope(p.data(), t);
    return t * Ftheta::Quotient(p.data(), t);
  };
  return SolveIncreasing(f, value, 0.0, high, start);
}

}  // namespace

LensDomain FthetaDomain(const double* params, double angle_limit) {
  const std::span<const double> p = Reference(params);
  std::vector<double> slope;
  for (std::size_t i = 1; i < p.size(); ++i) slope.push_back(static_cast<double>(i) * p[i]);
  // The reference is one-to-one up to its first fold.
  const double fold = SmallestPositiveRoot(slope);
  double angle = std::min({params[Ftheta::kMaxAngle], angle_limit, kPi});
  double radius = 0.0;
  if (IsAngleToPixel(params)) {
    angle = std::min(angle, fold);
    radius = EvaluatePolynomial(p, angle);
  } else {
    const double high = std::min(fold, kMaxPixel);
    if (EvaluatePolynomial(p, high) < angle) angle = EvaluatePolynomial(p, high);
    radius = Solve(p, angle, high, params[Ftheta::kA + 1] * angle);
    // Sampled up to just inside a fold, where Newton's steps end.
    constexpr int kSamples = 512;
    constexpr double kTolerance = 1e-11;
    for (int i = 1; i <= kSamples; ++i) {
      const double r = radius * i / kSamples;
      const double theta = EvaluatePolynomial(p, r);
      const double residual = EvaluatePolynomial(p, theta * Ftheta::Gain(params, theta)) - theta;
      if (std::abs(residual) <= kTolerance) continue;
      std::ostringstream message;
      message << "ftheta: A is not the inverse of the reference B at theta " << theta
              << " rad; give the A that was fitted with it, or a smaller max_angle";
      throw InputError(message.str());
    }
  }
  LensDomain domain;
  SetCone(angle, &domain);
  domain.max_radius = domain.limits[0] = radius;
  return domain;
}

bool UnprojectFtheta(const LensDomain& domain, const double* params, double x, double y,
                     double* ray) {
  const double radius = std::hypot(x, y);
  if (!(radius < domain.limits[0])) return false;
  const std::span<const double> p = Reference(params);
  const double theta = IsAngleToPixel(params) ? Solve(p, radius, domain.max_angle, radius / p[1])
                                              : EvaluatePolynomial(p, radius);
  if (!(theta < domain.max_angle)) return false;
  // (x, y) sin(theta) / radius has length sin(theta): with cos(theta) a unit ray.
  const double over = radius > 0.0 ? std::sin(theta) / radius : 0.0;
  ray[0] = over * x;
  ray[1] = over * y;
  ray[2] = std::cos(theta);
  return true;
}

}  // namespace gsut
