// Domain and inverse of angle -> radius polynomials: the fisheye lenses without tangential terms.
#include "gsut/cameras/odd_polynomial.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include "gsut/cameras/contract.h"
#include "gsut/cameras/polynomial.h"

namespace gsut {
namespace {

std::span<const double> Coefficients(const double* params, int num_params) {
  return {params + 4, static_cast<std::size_t>(num_params - 4)};
}

// rd = theta (1 + k1 theta^2 + k2 theta^4 + ...), by Horner's rule from the last coefficient:
//   d(rd)/d(theta) = 1 + 3 k1 theta^2 + 5 k2 theta^4 + ...
// rd and its derivative.
double Evaluate(std::span<const double> k, double theta, double* derivative) {
  const double square = theta * theta;
  double factor = 0.0, slope = 0.0;
  for (std::size_t i = k.size(); i-- > 0;) {
    factor = (factor + k[i]) * square;
    slope = (slope + static_cast<double>(2 * i + 3) * k[i]) * square;
  }
  if (derivative != nullptr) *derivative = 1.0 + slope;
  return theta * (1.0 + factor);
}

double Invert(std::span<const double> k, double max_angle, double radius) {
  return SolveIncreasing(
      [k](double angle, double* derivative) { return Evaluate(k, angle, derivative); }, radius, 0.0,
      max_angle, radius);
}

}  // namespace

LensDomain OddPolynomialDomain(const double* params, int num_params, double angle_limit) {
  const std::span<const double> k = Coefficients(params, num_params);
  std::vector<double> slope = {1.0};  // of rd, as a polynomial in theta^2
  for (std::size_t i = 0; i < k.size(); ++i) {
    slope.push_back(static_cast<double>(2 * i + 3) * k[i]);
  }
  // One-to-one while the slope, a polynomial in theta^2, is positive.
  LensDomain domain;
  domain.max_angle = std::min({kPi, angle_limit, std::sqrt(SmallestPositiveRoot(slope))});
  const double largest = LargestDistortedRadius(params);
  if (!(Evaluate(k, domain.max_angle, nullptr) < largest)) {
    domain.max_angle = Invert(k, domain.max_angle, largest);
  }
  domain.max_radius = Evaluate(k, domain.max_angle, nullptr);
  return domain;
}

bool UnprojectOddPolynomial(const LensDomain& domain, const double* params, int num_params,
                            double u, double v, double* ray) {
  const std::span<const double> k = Coefficients(params, num_params);
  double x = 0.0, y = 0.0;
  if (!FromPixel(params, u, v, &x, &y)) return false;
  const double radius = std::hypot(x, y);
  if (!(radius < domain.max_radius)) return false;
  if (radius == 0.0) {
    ray[0] = ray[1] = 0.0;
    ray[2] = 1.0;
    return true;
  }
  // Newton inside a bracket: the radius rises with the angle all through the domain.
  const double theta = Invert(k, domain.max_angle, radius);
  if (!(theta < domain.max_angle)) return false;
  double slope = 0.0;
  const double scale = Evaluate(k, theta, &slope) / radius;
  const double gain = std::max(params[0], params[1]) * theta * slope;
  const double back_u = params[0] * scale * x + params[2];
  const double back_v = params[1] * scale * y + params[3];
  if (!InverseConverged(u, v, back_u, back_v, gain)) return false;
  // The azimuth is that of the pixel: only the radius is distorted.
  const double sine_over_radius = std::sin(theta) / radius;
  ray[0] = x * sine_over_radius;
  ray[1] = y * sine_over_radius;
  ray[2] = std::cos(theta);
  return true;
}

}  // namespace gsut
