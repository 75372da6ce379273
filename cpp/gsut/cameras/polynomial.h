// Real roots of polynomials, found safely.
#pragma once

#include <functional>
#include <span>

namespace gsut {

// c[0] + c[1] x + ... by Horner.
double EvaluatePolynomial(std::span<const double> coefficients, double x);

// The smallest x > 0 where the polynomial vanishes or changes sign; infinity if there is none. A
// root that only touches zero counts. Found from the roots of the derivatives, between which a
// polynomial is monotone, by bisection: no root is lost however ill-conditioned its neighbours are.
// Accurate to a few units in the last place times the root's own condition.
// Requires coefficients[0] != 0.
double SmallestPositiveRoot(std::span<const double> coefficients);

// Solves f(x) = target for f strictly increasing on [low, high] with f(low) <= target <= f(high);
// f returns its value and stores its derivative. Newton steps, kept inside the bracket by
// bisection.
double SolveIncreasing(const std::function<double(double x, double* derivative)>& f, double target,
                       double low, double high, double start);

}  // namespace gsut
