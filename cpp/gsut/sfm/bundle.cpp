// Levenberg-Marquardt on poses, points and lenses.
#include "gsut/sfm/bundle.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/base/interrupt.h"
#include "gsut/sfm/bundle_problem.h"
#include "gsut/sfm/lens_parameters.h"

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

// Velocities and rigs: one entry an image, indices that are there.
void CheckMotions(const Bundle& bundle, const BundleOptions& options) {
  const std::size_t images = bundle.camera_from_world.size();
  // Empty means that there are none.
  const auto fits = [&](std::size_t size) { return size == 0 || size == images; };
  if (!fits(bundle.velocities.size()) || !fits(bundle.body_of_image.size()) ||
      !fits(bundle.mount_of_image.size()) || !fits(options.velocity_priors.size()) ||
      !fits(options.place_priors.size()) || !fits(options.velocity_fixed.size())) {
    throw InputError("velocities, priors, flags, bodies and mounts must have one entry an image");
  }
  // -1: the camera is the body itself.
  const int mounts = static_cast<int>(bundle.camera_from_body.size());
  for (const int mount : bundle.mount_of_image) {
    if (mount < -1 || mount >= mounts) {
      throw InputError("mount_of_image names mount " + std::to_string(mount) + " of " +
                       std::to_string(mounts));
    }
  }
  // Every body from 0 on has an image.
  std::vector<std::uint8_t> seen(images, 0);
  int bodies = 0;
  for (const int body : bundle.body_of_image) {
    if (body < 0 || body >= static_cast<int>(images)) {
      throw InputError("body_of_image names body " + std::to_string(body) + " of at most " +
                       std::to_string(images));
    }
    seen[body] = 1;
    bodies = std::max(bodies, body + 1);
  }
  if (std::count(seen.begin(), seen.begin() + bodies, 1) != bodies) {
    throw InputError("body_of_image leaves out a body below the largest");
  }
  if (!options.mount_free.empty() && static_cast<int>(options.mount_free.size()) != mounts) {
    throw InputError("mount_free must be empty or have one flag a mount");
  }
  if (!options.mount_priors.empty() && static_cast<int>(options.mount_priors.size()) != mounts) {
    throw InputError("mount_priors must be empty or have one pose a mount");
  }
  for (const TurnPrior& turn : options.turn_priors) {
    const auto inside = [&](int image) { return image >= 0 && image < static_cast<int>(images); };
    if (!inside(turn.first) || !inside(turn.second) || turn.first == turn.second || mounts > 0 ||
        turn.by_calibration.cols() != options.calibration_sigma.size() || !(turn.sigma > 0)) {
      throw InputError(
          "a turn must be between two images without a rig, with one column an unknown of the "
          "calibration and a standard deviation above 0");
    }
  }
}

}  // namespace

void CheckObservations(const Bundle& bundle) {
  const int images = static_cast<int>(bundle.camera_from_world.size());
  const int points = static_cast<int>(bundle.points.size());
  const auto inside = [](int index, int count) { return index >= 0 && index < count; };
  for (const BundleObservation& observation : bundle.observations) {
    if (inside(observation.image, images) && inside(observation.point, points)) continue;
    throw InputError("an observation names image " + std::to_string(observation.image) +
                     " and point " + std::to_string(observation.point) + "; there are " +
                     std::to_string(images) + " and " + std::to_string(points));
  }
}

namespace {

// Throws InputError for an index out of range, or a list whose length does not fit; says which.
// Everything that indexes something is checked here, once, so that no inner loop has to.
void CheckBundle(const Bundle& bundle, const BundleOptions& options) {
  const int images = static_cast<int>(bundle.camera_from_world.size());
  const int points = static_cast<int>(bundle.points.size());
  const auto inside = [](int index, int count) { return index >= 0 && index < count; };
  if (bundle.camera_of_image.size() != bundle.camera_from_world.size()) {
    throw InputError("camera_of_image must have one entry an image");
  }
  for (const int camera : bundle.camera_of_image) {
    if (!inside(camera, static_cast<int>(bundle.cameras.size()))) {
      throw InputError("camera_of_image names camera " + std::to_string(camera) + " of " +
                       std::to_string(bundle.cameras.size()));
    }
  }
  CheckObservations(bundle);
  const auto fits = [](const std::vector<std::uint8_t>& flags, int count) {
    return flags.empty() || static_cast<int>(flags.size()) == count;
  };
  if (!fits(options.image_fixed, images) || !fits(options.point_fixed, points)) {
    throw InputError("image_fixed and point_fixed must be empty or have one flag each");
  }
  // Negative: the gauge is not held by an image.
  if (options.gauge_image >= images || options.scale_image >= images) {
    throw InputError("gauge_image or scale_image is not among the images");
  }
  // Residuals of bearings do not see the lens' parameters: only pixels through the lens do.
  CheckMotions(bundle, options);
  if (!options.lens_free.empty() && !options.through_lens) {
    throw InputError("lens_free needs through_lens");
  }
  CheckLensFlags(bundle.cameras, options.lens_free);
  for (const PointPrior& prior : options.point_priors) {
    if (inside(prior.point, points) && options.point_fixed.empty() &&
        (prior.sigma.array() > 0).all()) {
      continue;
    }
    throw InputError("a stated point must be among the points, none of which is fixed, with " +
                     std::string("standard deviations above 0"));
  }
  bool known = options.lens_priors.empty() || options.lens_priors.size() == bundle.cameras.size();
  for (std::size_t c = 0; known && c < options.lens_priors.size(); ++c) {
    const LensPrior& prior = options.lens_priors[c];
    const auto own = static_cast<std::size_t>(bundle.cameras[c].num_params());
    known = prior.mean.size() == prior.sigma.size() &&
            (prior.sigma.empty() || prior.sigma.size() == own);
  }
  if (!known) throw InputError("lens_priors must have a mean and a sigma of each parameter");
}

}  // namespace

BundleSummary AdjustBundle(Bundle* bundle, const BundleOptions& options) {
  CheckGiven(bundle, "bundle");
  CheckBundle(*bundle, options);
  if (bundle->observations.empty()) return {};
  BundleProblem problem(*bundle, options);
  BundleSummary summary;
  summary.fill = problem.system().matrix().Fill();
  double cost = problem.Evaluate();
  summary.cost_before = cost;
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
  summary.cost_after = cost;
  problem.Store(bundle);
  return summary;
}

}  // namespace gsut
