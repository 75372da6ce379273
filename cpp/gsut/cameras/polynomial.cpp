// Real roots of polynomials, found safely.
#include "gsut/cameras/polynomial.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

namespace gsut {
namespace {

constexpr double kUnitRoundoff = std::numeric_limits<double>::epsilon();

// Bound of the rounding error of EvaluatePolynomial.
double EvaluationError(std::span<const double> c, double x) {
  double sum = 0.0;
  for (std::size_t i = c.size(); i-- > 0;) sum = sum * std::abs(x) + std::abs(c[i]);
  return 2.0 * static_cast<double>(c.size()) * kUnitRoundoff * sum;
}

// Between low and high, where the polynomial has different signs and is monotone.
double Bisect(std::span<const double> c, double low, double high) {
  const bool low_negative = EvaluatePolynomial(c, low) < 0.0;
  for (;;) {
    const double middle = 0.5 * (low + high);
    if (!(middle > low && middle < high)) return low;
    ((EvaluatePolynomial(c, middle) < 0.0) == low_negative ? low : high) = middle;
  }
}

// Between neighbouring roots of its derivative a polynomial is monotone, so at most one root lies
// there, and bisection finds it: no start value, no divergence. The derivative's roots come the
// same way. All x in (0, 1] where the polynomial vanishes, touches zero or changes sign; ascending.
std::vector<double> RootsInUnitInterval(std::span<const double> c) {
  // Zero leading coefficients would make a derivative of the wrong degree.
  while (!c.empty() && c.back() == 0.0) c = c.first(c.size() - 1);
  if (c.size() < 2) return {};
  std::vector<double> derivative(c.size() - 1);
  for (std::size_t i = 1; i < c.size(); ++i) derivative[i - 1] = static_cast<double>(i) * c[i];
  std::vector<double> knots = RootsInUnitInterval(derivative);
  knots.push_back(1.0);
  std::vector<double> roots;
  double low = 0.0;
  for (const double knot : knots) {
    const double at_low = EvaluatePolynomial(c, low);
    const double at_knot = EvaluatePolynomial(c, knot);
    // A touching root has no change of sign: a value within its rounding error counts as zero.
    if (std::abs(at_knot) <= EvaluationError(c, knot)) {
      roots.push_back(knot);
    } else if (low != knot && at_low != 0.0 && (at_low < 0.0) != (at_knot < 0.0) &&
               (roots.empty() || roots.back() != low)) {
      roots.push_back(Bisect(c, low, knot));
    }
    low = knot;
  }
  roots.erase(std::unique(roots.begin(), roots.end()), roots.end());
  return roots;
}

}  // namespace

// Horner's rule: as many multiplications as coefficients, and the smallest rounding error.
double EvaluatePolynomial(std::span<const double> coefficients, double x) {
  double sum = 0.0;
  for (std::size_t i = coefficients.size(); i-- > 0;) sum = sum * x + coefficients[i];
  return sum;
}

double SmallestPositiveRoot(std::span<const double> coefficients) {
  const std::vector<double> near = RootsInUnitInterval(coefficients);
  if (!near.empty()) return near.front();
  // Beyond 1, with x = 1 / t: the largest root of the reversed polynomial.
  std::span<const double> trimmed = coefficients;
  while (!trimmed.empty() && trimmed.back() == 0.0) trimmed = trimmed.first(trimmed.size() - 1);
  const std::vector<double> reversed(trimmed.rbegin(), trimmed.rend());
  const std::vector<double> far = RootsInUnitInterval(reversed);
  return far.empty() ? std::numeric_limits<double>::infinity() : 1.0 / far.back();
}

// Newton's method inside a bracket that every evaluation shrinks: quadratic where the function is
// smooth, never worse than halving.
double SolveIncreasing(const std::function<double(double x, double* derivative)>& f, double target,
                       double low, double high, double start) {
  // Halving alone needs about 1100 steps over all doubles, and about 60 over any one scale.
  constexpr int kMaxSteps = 1200;
  double x = start > low && start < high ? start : 0.5 * (low + high);
  double last_step = high - low;
  for (int i = 0; i < kMaxSteps; ++i) {
    double derivative = 0.0;
    const double residual = f(x, &derivative) - target;
    if (residual == 0.0) return x;
    (residual < 0.0 ? low : high) = x;
    double next = x - residual / derivative;
    // Outside the bracket, NaN, or not shrinking: halve instead.
    if (!(next > low && next < high) || !(std::abs(next - x) < 0.5 * last_step)) {
      if (next == x) return x;
      next = 0.5 * (low + high);
      if (!(next > low && next < high)) return x;
    }
    last_step = std::abs(next - x);
    x = next;
    if (last_step <= 0.5 * kUnitRoundoff * std::abs(x)) return x;
  }
  return x;
}

}  // namespace gsut
