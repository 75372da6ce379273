// Domains and inverses of lenses whose image radius depends on the angle from the axis alone.
#include "gsut/cameras/radial_inverses.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <sstream>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/cameras/contract.h"
#include "gsut/cameras/polynomial.h"
#include "gsut/cameras/visit_lens.h"

namespace gsut {

// --- Cones, and any radius that rises with the angle ---

void CheckLensParam(const char* lens, const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return;
  std::ostringstream message;
  message << lens << ": " << name << " is " << value << "; it must be between " << low << " and "
          << high;
  throw InputError(message.str());
}

// limits[3] is tan of half the angle, by which kernels test for the cone without an arctangent.
void SetCone(double angle, LensDomain* domain) {
  domain->max_angle = angle;
  domain->limits[3] = angle < kPi ? std::tan(0.5 * angle) : kInfinity;
}

// The radius rises with the angle up to `angle`; bisection finds where it leaves the largest pixel.
LensDomain RadialDomain(const double* params, double angle, double angle_limit,
                        const std::function<double(double angle)>& radius) {
  const double largest = LargestDistortedRadius(params);
  const auto has_image = [&](double at) {
    const double r = radius(at);
    return r >= 0.0 && r <= largest;
  };
  double end = std::min({angle, angle_limit, kPi});
  if (!has_image(end)) {
    double low = 0.0, high = end;
    for (;;) {
      const double middle = 0.5 * (low + high);
      if (!(middle > low && middle < high)) break;
      (has_image(middle) ? low : high) = middle;
    }
    end = low;
  }
  LensDomain domain;
  SetCone(end, &domain);
  domain.max_radius = radius(end);
  return domain;
}

// Beyond 90 degrees the cone is the complement of one behind: the two tests differ there.
bool RayInCone(const LensDomain& domain, double x, double y, double z, double* ray) {
  const double h = std::hypot(x, y);
  const double n = std::hypot(h, z);
  if (!(n > 0.0 && n < kInfinity)) return false;
  const bool inside = domain.max_angle < kPi ? lenses::Cone::Contains(domain, h, z, n)
                                             : lenses::Cone::ContainsOrBehind(domain, h, z, n);
  if (!inside) return false;
  ray[0] = x / n;
  ray[1] = y / n;
  ray[2] = z / n;
  return true;
}

// --- The pinhole ---

// Radius tan(theta): never beyond 90 degrees, nor so near them that pixels overflow.
LensDomain PinholeDomain(const double* params, double angle_limit) {
  LensDomain domain;
  double radius = LargestDistortedRadius(params);
  if (angle_limit < 0.5 * kPi) radius = std::min(radius, std::tan(angle_limit));
  domain.max_angle = std::atan(radius);
  domain.max_radius = radius;
  domain.limits[0] = radius * radius;
  return domain;
}

bool UnprojectPinhole(const LensDomain& domain, const double* params, double u, double v,
                      double* ray) {
  double x = 0.0, y = 0.0;
  if (!FromPixel(params, u, v, &x, &y) || !(x * x + y * y < domain.limits[0])) return false;
  // (x, y, 1) is the ray at depth one.
  const double norm = std::sqrt(1.0 + x * x + y * y);
  ray[0] = x / norm;
  ray[1] = y / norm;
  ray[2] = 1.0 / norm;
  return true;
}

// --- Angle -> radius polynomials: the fisheye lenses without tangential terms ---

namespace {

std::span<const double> OddCoefficients(const double* params, int num_params) {
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
  const std::span<const double> k = OddCoefficients(params, num_params);
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
  const std::span<const double> k = OddCoefficients(params, num_params);
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

// --- The f-theta lens ---

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

// --- The polynomial fisheye of OCamCalib ---

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
