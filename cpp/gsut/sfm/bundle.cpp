// Levenberg-Marquardt on poses, points and lenses.
#include "gsut/sfm/bundle.h"

#include <algorithm>
#include <cmath>

#include "gsut/base/errors.h"
#include "gsut/base/interrupt.h"
#include "gsut/sfm/bundle_check.h"
#include "gsut/sfm/bundle_problem.h"

namespace gsut {
namespace {

// Trust region of Levenberg-Marquardt, in the form of Madsen, Nielsen and Tingleff, "Methods for
// non-linear least squares problems", 2004: damping is the diagonal of J^T J over a radius.
constexpr double kFirstRadius = 1e4;  // nearly Gauss-Newton: starts are good, and the cost decides
constexpr double kLargestRadius = 1e16;  // beyond, damping is below the rounding of the diagonal
// Share of the predicted decrease that a step must reach to be kept.
constexpr double kLeastQuality = 1e-3;
// Steps in a row that may fail to predict a decrease: each at least halves the radius.
constexpr int kMostInvalid = 5;
// Share of the cost below which a predicted decrease is rounding alone.
constexpr double kNothing = 1e-15;

}  // namespace

BundleSummary AdjustBundle(Bundle* bundle, const BundleOptions& options) {
  CheckBundle(*bundle, options);
  if (bundle->observations.empty()) return {};
  BundleProblem problem(*bundle, options);
  BundleSummary summary;
  summary.fill = problem.system().matrix().Fill();
  summary.rms_before = problem.Rms();
  double cost = problem.Evaluate();
  if (!std::isfinite(cost)) throw SolveError("bundle adjustment failed: residuals are not finite");
  // Each iteration solves the damped normal equations and compares the decrease of the cost with
  // the one that the linear model predicts. Nielsen's rule then changes the radius smoothly: a good
  // prediction multiplies it by up to 3, a failed step divides it by 2, 4, 8 ... in a row.
  double radius = kFirstRadius, shrink = 2.0;
  int invalid = 0;
  while (!summary.converged && summary.iterations < options.max_iterations) {
    CheckInterrupt();
    ++summary.iterations;
    const bool solved = problem.system().Solve(radius);
    const double predicted = solved ? problem.system().PredictedDecrease() : 0.0;
    if (solved && std::abs(predicted) <= kNothing * cost) {
      summary.converged = true;
      break;
    }
    // Not positive definite, or rounding: more damping mends both.
    if (!(predicted > 0.0)) {
      if (++invalid == kMostInvalid) {
        throw SolveError("bundle adjustment failed: no step lowers the cost");
      }
      radius /= shrink;
      shrink *= 2.0;
      continue;
    }
    invalid = 0;
    // The step is taken for trial, and taken back if the cost did not fall enough.
    const BundleState before = problem.state();
    const bool small = problem.Step();
    const double found = problem.Evaluate();
    const double quality = std::isfinite(found) ? (cost - found) / predicted : -1.0;
    const bool better = quality > kLeastQuality;
    summary.converged = small || (std::isfinite(found) &&
                                  std::abs(cost - found) <= options.function_tolerance * cost);
    if (better) {
      cost = found;
      radius = std::min(kLargestRadius,
                        radius / std::max(1.0 / 3.0, 1.0 - std::pow(2.0 * quality - 1.0, 3)));
      shrink = 2.0;
      continue;
    }
    problem.Restore(before);
    radius /= shrink;
    shrink *= 2.0;
    if (!summary.converged) problem.Evaluate();  // the derivatives there
  }
  CheckInterrupt();
  summary.rms_after = problem.Rms();
  summary.num_outside = problem.NumOutside();
  problem.Store(bundle);
  return summary;
}

}  // namespace gsut
