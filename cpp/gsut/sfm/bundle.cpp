// Bundle adjustment by Ceres, with derivatives written out.
#include "gsut/sfm/bundle.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>

#include "gsut/base/errors.h"
#include "gsut/sfm/bundle_cost.h"
#include "gsut/sfm/lens_evaluation.h"
#include "gsut/sfm/lens_parameters.h"
#include "gsut/sfm/pose_manifold.h"
#include "gsut/sfm/solver_log.h"
#include "gsut/sfm/stop_after.h"

namespace gsut {
namespace {

// Up to this many images the reduced system is solved as a dense one.
constexpr int kMostDenseImages = 150;
// Beyond, if this share of the pairs of images has a common point: then even SuiteSparse is no
// faster, and Eigen's sparse factorisation, that of a Ceres without it, up to three times slower.
constexpr double kDenseShare = 0.3;

bool IsDense(const Bundle& bundle, const BundleState& state) {
  const std::size_t bodies = state.num_bodies();
  if (bodies <= kMostDenseImages) return true;
  std::vector<std::vector<int>> seen_from(bundle.points.size());
  for (const BundleObservation& observation : bundle.observations) {
    seen_from[observation.point].push_back(state.body_of_image[observation.image]);
  }
  std::vector<std::uint8_t> shared(bodies * bodies);
  for (const std::vector<int>& point : seen_from) {
    for (const int a : point) {
      for (const int b : point) shared[a * bodies + b] = 1;
    }
  }
  const auto pairs = std::count(shared.begin(), shared.end(), 1);
  return static_cast<double>(pairs) > kDenseShare * static_cast<double>(shared.size());
}

bool Flag(const std::vector<std::uint8_t>& flags, int index) {
  return !flags.empty() && flags[index] != 0;
}

// Velocities and rigs: one entry an image, indices that are there.
void CheckMotions(const Bundle& bundle, const BundleOptions& options) {
  const std::size_t images = bundle.camera_from_world.size();
  const auto fits = [&](std::size_t size) { return size == 0 || size == images; };
  if (!fits(bundle.velocities.size()) || !fits(bundle.body_of_image.size()) ||
      !fits(bundle.mount_of_image.size()) || !fits(options.velocity_priors.size())) {
    throw InputError("velocities, their priors, bodies and mounts must have one entry an image");
  }
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
}

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
  for (const BundleObservation& observation : bundle.observations) {
    if (inside(observation.image, images) && inside(observation.point, points)) continue;
    throw InputError("an observation names image " + std::to_string(observation.image) +
                     " and point " + std::to_string(observation.point) + "; there are " +
                     std::to_string(images) + " and " + std::to_string(points));
  }
  const auto fits = [](const std::vector<std::uint8_t>& flags, int count) {
    return flags.empty() || static_cast<int>(flags.size()) == count;
  };
  if (!fits(options.image_fixed, images) || !fits(options.point_fixed, points)) {
    throw InputError("image_fixed and point_fixed must be empty or have one flag each");
  }
  if (options.gauge_image >= images || options.scale_image >= images) {
    throw InputError("gauge_image or scale_image is not among the images");
  }
  CheckMotions(bundle, options);
  if (!options.lens_free.empty() && !options.through_lens) {
    throw InputError("lens_free needs through_lens");
  }
  CheckLensFlags(bundle.cameras, options.lens_free);
}

// Points are eliminated first. Each array is a group of its own: within a group Ceres goes by
// addresses, which differ from run to run between arrays, and so would the last bits.
enum Group { kPoints, kPoses, kVelocities, kMounts, kLenses };  // and one more for each lens

// A bundle as a problem for Ceres.
class BundleProblem {
 public:
  // Both are kept by reference.
  BundleProblem(const Bundle& bundle, const BundleOptions& options)
      : bundle_(bundle),
        options_(options),
        state_(bundle),
        gauge_body_(BodyOf(options.gauge_image)),
        scale_body_(gauge_body_ < 0 ? -1 : BodyOf(options.scale_image)),
        cauchy_(options.loss_scale > 0 ? options.loss_scale : 1.0),
        scaled_pose_(
            scale_body_ < 0 ? -1 : ScaleAxis(state_.poses[gauge_body_], state_.poses[scale_body_])),
        ordering_(std::make_shared<ceres::ParameterBlockOrdering>()),
        used_body_(state_.num_bodies()),
        fixed_body_(state_.num_bodies()),
        used_point_(state_.points.size()),
        used_lens_(state_.lenses.size()),
        used_mount_(state_.mounts.size()) {
    ceres::Problem::Options settings;
    settings.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    settings.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    if (options.through_lens) {
      evaluation_ = std::make_unique<LensEvaluation>(bundle, state_, !options.lens_free.empty());
      settings.evaluation_callback = evaluation_.get();
    }
    problem_ = std::make_unique<ceres::Problem>(settings);
    AddObservations();
    AddBodies();
    AddPoints();
    AddMounts();
    AddLenses();
  }

  BundleSummary Solve() {
    ceres::Solver::Options solver;
    solver.linear_solver_ordering = ordering_;
    BundleSummary summary;
    summary.dense = IsDense(bundle_, state_);
    solver.linear_solver_type = summary.dense ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
    solver.max_num_iterations = options_.max_iterations;
    solver.function_tolerance = options_.function_tolerance;
    solver.num_threads = std::max(1, options_.num_threads);
    solver.logging_type = ceres::SILENT;
    StopWhenInterrupted stop;
    solver.callbacks.push_back(&stop);
    summary.rms_before = Rms();
    ceres::Solver::Summary found;
    {
      const QuietSolver quiet;  // a step that fails is tried again shorter: nothing to tell
      ceres::Solve(solver, problem_.get(), &found);
    }
    CheckInterrupt();
    if (!found.IsSolutionUsable()) {
      throw SolveError("bundle adjustment failed: " + found.message);
    }
    summary.rms_after = Rms();
    summary.num_outside = evaluation_ ? evaluation_->NumOutside() : 0;
    summary.iterations = static_cast<int>(found.iterations.size()) - 1;
    summary.converged = found.termination_type == ceres::CONVERGENCE;
    return summary;
  }

  // Writes what was solved for.
  void Store(Bundle* bundle) const {
    for (std::size_t i = 0; i < bundle->camera_from_world.size(); ++i) {
      const int image = static_cast<int>(i);
      const int body = BodyOf(image);
      if (!used_body_[body]) continue;
      if (!bundle->velocities.empty()) bundle->velocities[i] = state_.velocities[body];
      // A pose that stayed keeps its digits; other cameras of its body follow it.
      const bool stays = (body == gauge_body_ || fixed_body_[body]) &&
                         state_.image_of_body[body] == image && state_.mount_of_image[image] < 0;
      if (!stays) bundle->camera_from_world[i] = state_.CameraFromWorld(image);
    }
    for (std::size_t m = 0; m < state_.mounts.size(); ++m) {
      if (used_mount_[m] && Flag(options_.mount_free, static_cast<int>(m))) {
        bundle->camera_from_body[m] = FromBlock(state_.mounts[m]);
      }
    }
    bundle->points = state_.points;
    for (std::size_t c = 0; c < state_.lenses.size(); ++c) {
      if (!used_lens_[c]) continue;
      const Camera& camera = bundle->cameras[c];
      bundle->cameras[c] = Camera(camera.model(), state_.lenses[c], camera.width(), camera.height(),
                                  camera.valid_field_angle());
    }
  }

 private:
  int BodyOf(int image) const { return image < 0 ? -1 : state_.body_of_image[image]; }

  void AddObservations() {
    ceres::LossFunction* loss = options_.loss_scale > 0 ? &cauchy_ : nullptr;
    for (std::size_t i = 0; i < bundle_.observations.size(); ++i) {
      const BundleObservation& observation = bundle_.observations[i];
      const int camera = bundle_.camera_of_image[observation.image];
      const int mount = state_.mount_of_image[observation.image];
      const bool lens_free = !options_.lens_free.empty() && !options_.lens_free[camera].empty();
      auto* cost =
          new ReprojectionCost(bundle_, state_, static_cast<int>(i), evaluation_.get(), lens_free);
      problem_->AddResidualBlock(cost, loss, cost->Blocks(&state_));
      used_lens_[camera] |= lens_free;
      used_body_[BodyOf(observation.image)] = used_point_[observation.point] = 1;
      if (mount >= 0) used_mount_[mount] = 1;
    }
  }

  void AddBodies() {
    for (std::size_t image = 0; image < options_.image_fixed.size(); ++image) {
      if (options_.image_fixed[image]) fixed_body_[BodyOf(static_cast<int>(image))] = 1;
    }
    for (int body = 0; body < state_.num_bodies(); ++body) {
      if (!used_body_[body]) continue;
      double* pose = state_.poses[body].data();
      ordering_->AddElementToGroup(pose, kPoses);
      problem_->SetManifold(pose, body == scale_body_ ? &scaled_pose_ : &free_pose_);
      if (body == gauge_body_ || fixed_body_[body]) problem_->SetParameterBlockConstant(pose);
      if (state_.velocities.empty()) continue;
      double* velocity = state_.velocities[body].data();
      ordering_->AddElementToGroup(velocity, kVelocities);
      if (fixed_body_[body]) {
        problem_->SetParameterBlockConstant(velocity);
      } else if (!options_.velocity_priors.empty()) {
        const VelocityPrior& prior = options_.velocity_priors[state_.image_of_body[body]];
        problem_->AddResidualBlock(new VelocityCost(prior, options_.noise), nullptr, velocity);
      }
    }
  }

  void AddPoints() {
    for (std::size_t i = 0; i < state_.points.size(); ++i) {
      if (!used_point_[i]) continue;
      double* point = state_.points[i].data();
      ordering_->AddElementToGroup(point, kPoints);
      if (Flag(options_.point_fixed, static_cast<int>(i))) {
        problem_->SetParameterBlockConstant(point);
      }
    }
  }

  void AddMounts() {
    for (std::size_t m = 0; m < state_.mounts.size(); ++m) {
      if (!used_mount_[m]) continue;
      double* mount = state_.mounts[m].data();
      ordering_->AddElementToGroup(mount, kMounts);
      problem_->SetManifold(mount, &free_pose_);
      if (!Flag(options_.mount_free, static_cast<int>(m))) {
        problem_->SetParameterBlockConstant(mount);
      }
    }
  }

  void AddLenses() {
    for (std::size_t c = 0; c < state_.lenses.size(); ++c) {
      if (!used_lens_[c]) continue;
      double* lens = state_.lenses[c].data();
      ordering_->AddElementToGroup(lens, kLenses + static_cast<int>(c));
      HoldLensParameters(options_.lens_free[c], lens, problem_.get(), &lens_manifolds_);
    }
  }

  // Of the residuals at the current unknowns.
  double Rms() {
    if (evaluation_) evaluation_->PrepareForEvaluation(false, true);
    double sum = 0.0;
    for (std::size_t i = 0; i < bundle_.observations.size(); ++i) {
      const BundleObservation& observation = bundle_.observations[i];
      LensEvaluation::Row row = {};
      if (evaluation_) row = evaluation_->Get(static_cast<int>(i));
      if (row.valid) {
        sum += (Eigen::Map<const Eigen::Vector2d>(row.pixel) - observation.pixel).squaredNorm();
      } else {
        const Eigen::Vector3d p = state_.Chain(observation).Point(state_.points[observation.point]);
        sum += BearingResidual(observation.bearing, p).squaredNorm();
      }
    }
    return std::sqrt(sum / std::max<std::size_t>(1, bundle_.observations.size()));
  }

  const Bundle& bundle_;
  const BundleOptions& options_;
  BundleState state_;
  int gauge_body_, scale_body_;
  std::unique_ptr<LensEvaluation> evaluation_;
  ceres::CauchyLoss cauchy_;
  PoseManifold free_pose_, scaled_pose_;
  std::vector<std::unique_ptr<ceres::Manifold>> lens_manifolds_;
  std::unique_ptr<ceres::Problem> problem_;
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering_;
  std::vector<std::uint8_t> used_body_, fixed_body_, used_point_, used_lens_, used_mount_;
};

}  // namespace

BundleSummary AdjustBundle(Bundle* bundle, const BundleOptions& options) {
  CheckBundle(*bundle, options);
  if (bundle->observations.empty()) return {};
  BundleProblem problem(*bundle, options);
  const BundleSummary summary = problem.Solve();
  problem.Store(bundle);
  return summary;
}

}  // namespace gsut
