// Domain of the polynomial fisheye of OCamCalib, and the start of its inverse.
#include "gsut/cameras/ocam_map.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "gsut/cameras/contract.h"
#include "gsut/cameras/polynomial.h"
#include "gsut/cameras/visit_lens.h"

namespace gsut {
namespace {

using lenses::Ocam;

// Radii at which the start of the inverse is fitted and checked: some twenty a coefficient.
constexpr int kSamples = 96;

double AngleAt(const double* params, int num_params, double rho) {
  double slope = 0.0;
  return std::atan2(rho, Ocam::Depth(params, num_params, rho, &slope));
}

// The angle is atan2(rho, depth), whose slope has the sign of depth - rho depth'.
// Where depth(rho) - rho depth'(rho), which is positive while the angle rises, vanishes.
double Fold(const double* params, int num_params) {
  std::vector<double> rise = {params[Ocam::kPolynomial], 0.0};
  for (int i = Ocam::kPolynomial + 1; i < num_params; ++i) {
    rise.push_back(-static_cast<double>(i - Ocam::kPolynomial) * params[i]);
  }
  return SmallestPositiveRoot(rise);
}

// The least squares of w (rho / (a0 theta) - 1) = b0 theta^2 + b1 theta^4 + b2 theta^6 over
// samples.
std::array<double, 3> FitStart(const std::vector<double>& theta, const std::vector<double>& ratio) {
  // Normal equations of three unknowns, with the right side as the fourth column.
  double m[3][4] = {};
  for (std::size_t i = 0; i < theta.size(); ++i) {
    const double square = theta[i] * theta[i];
    const double row[4] = {square, square * square, square * square * square, ratio[i] - 1.0};
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 4; ++k) m[j][k] += row[j] * row[k];
    }
  }
  for (int j = 0; j < 3; ++j) {  // Gauss-Jordan on a positive definite matrix
    for (int k = 0; k < 3; ++k) {
      if (k == j) continue;
      const double share = m[k][j] / m[j][j];
      for (int l = j; l < 4; ++l) m[k][l] -= share * m[j][l];
    }
  }
  return {m[0][3] / m[0][0], m[1][3] / m[1][1], m[2][3] / m[2][2]};
}

// The domain of rho < radius with the start of its inverse; false if the steps miss some rho.
bool TryRadius(const double* params, int num_params, double radius, LensDomain* domain) {
  constexpr double kTolerance = 1e-13;  // of a0 + rho
  const double a0 = params[Ocam::kPolynomial];
  std::vector<double> theta, ratio;
  for (int i = 1; i <= kSamples; ++i) {
    const double rho = radius * i / kSamples;
    theta.push_back(AngleAt(params, num_params, rho));
    ratio.push_back(rho / (a0 * theta.back()));
  }
  // A fit over the whole domain starts everywhere about equally well.
  const std::array<double, 3> start = FitStart(theta, ratio);
  std::copy(start.begin(), start.end(), domain->limits.begin());
  for (int i = 1; i <= kSamples; ++i) {
    const double rho = radius * i / kSamples;
    const double found = theta[i - 1] * Ocam::Gain(*domain, params, num_params, theta[i - 1]);
    if (!(std::abs(found - rho) <= kTolerance * (a0 + rho))) return false;
  }
  return true;
}

}  // namespace

LensDomain OcamDomain(const double* params, int num_params, double angle_limit) {
  constexpr double kStep = 0.98;  // of the radius, until the steps find the inverse everywhere
  const double limit = std::min(angle_limit, kPi);
  double radius = std::min(Fold(params, num_params), Ocam::kFarthest * params[Ocam::kPolynomial]);
  if (AngleAt(params, num_params, radius) > limit) {
    radius = SolveIncreasing(
        [&](double rho, double* derivative) {
          double slope = 0.0;
          const double depth = Ocam::Depth(params, num_params, rho, &slope);
          *derivative = (depth - rho * slope) / (depth * depth + rho * rho);
          return std::atan2(rho, depth);
        },
        limit, 0.0, radius, std::min(radius, params[Ocam::kPolynomial] * limit));
  }
  // Near a fold no polynomial starts well: the domain ends before.
  LensDomain domain;
  while (!TryRadius(params, num_params, radius, &domain)) radius *= kStep;
  SetCone(std::min(AngleAt(params, num_params, radius), limit), &domain);
  domain.max_radius = radius;
  return domain;
}

}  // namespace gsut
