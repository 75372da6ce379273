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
#include "gsut/sfm/pose_manifold.h"
#include "gsut/sfm/solver_log.h"

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
  if (options.lens_free.empty()) return;
  if (!options.through_lens) throw InputError("lens_free needs through_lens");
  bool same = options.lens_free.size() == bundle.cameras.size();
  for (std::size_t c = 0; same && c < bundle.cameras.size(); ++c) {
    same = options.lens_free[c].empty() ||
           static_cast<int>(options.lens_free[c].size()) == bundle.cameras[c].num_params();
  }
  if (!same) throw InputError("lens_free must have one flag a parameter of each camera");
}

double Rms(const Bundle& bundle, const BundleState& state, const LensEvaluation* lenses) {
  double sum = 0.0;
  for (std::size_t i = 0; i < bundle.observations.size(); ++i) {
    const BundleObservation& observation = bundle.observations[i];
    const LensEvaluation::Row row =
        lenses != nullptr ? lenses->Get(static_cast<int>(i)) : LensEvaluation::Row{};
    if (row.valid) {
      sum += (Eigen::Map<const Eigen::Vector2d>(row.pixel) - observation.pixel).squaredNorm();
    } else {
      const Eigen::Vector3d p = state.Chain(observation).Point(state.points[observation.point]);
      sum += BearingResidual(observation.bearing, p).squaredNorm();
    }
  }
  return std::sqrt(sum / std::max<std::size_t>(1, bundle.observations.size()));
}

// The component of the second centre that is farthest from the first's.
int ScaleAxis(const PoseBlock& first, const PoseBlock& second) {
  int axis = 0;
  (CenterOf(second.data()) - CenterOf(first.data())).cwiseAbs().maxCoeff(&axis);
  return axis;
}

}  // namespace

BundleSummary AdjustBundle(Bundle* bundle, const BundleOptions& options) {
  CheckBundle(*bundle, options);
  BundleSummary summary;
  if (bundle->observations.empty()) return summary;
  BundleState state(*bundle);
  const bool lenses_free = !options.lens_free.empty();
  std::unique_ptr<LensEvaluation> evaluation;
  ceres::Problem::Options problem_options;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  if (options.through_lens) {
    evaluation = std::make_unique<LensEvaluation>(*bundle, state, lenses_free);
    problem_options.evaluation_callback = evaluation.get();
  }
  ceres::CauchyLoss cauchy(options.loss_scale > 0 ? options.loss_scale : 1.0);
  ceres::LossFunction* loss = options.loss_scale > 0 ? &cauchy : nullptr;
  PoseManifold free_pose;
  const auto body_of = [&](int image) { return image < 0 ? -1 : state.body_of_image[image]; };
  const int gauge_body = body_of(options.gauge_image);
  const int scale_body = gauge_body < 0 ? -1 : body_of(options.scale_image);
  PoseManifold scaled_pose(
      scale_body >= 0 ? ScaleAxis(state.poses[gauge_body], state.poses[scale_body]) : -1);
  std::vector<std::unique_ptr<ceres::Manifold>> lens_manifolds;
  ceres::Problem problem(problem_options);
  std::vector<std::uint8_t> used_body(state.num_bodies()), fixed_body(state.num_bodies()),
      used_point(state.points.size()), used_lens(state.lenses.size()),
      used_mount(state.mounts.size());
  for (std::size_t i = 0; i < bundle->observations.size(); ++i) {
    const BundleObservation& observation = bundle->observations[i];
    const int camera = bundle->camera_of_image[observation.image];
    const bool lens_free = lenses_free && !options.lens_free[camera].empty();
    auto* cost = new SightCost(*bundle, state, static_cast<int>(i), evaluation.get(), lens_free);
    problem.AddResidualBlock(cost, loss, cost->Blocks(&state));
    used_lens[camera] |= lens_free;
    used_body[body_of(observation.image)] = used_point[observation.point] = 1;
    if (state.mount_of_image[observation.image] >= 0) {
      used_mount[state.mount_of_image[observation.image]] = 1;
    }
  }
  for (std::size_t image = 0; image < options.image_fixed.size(); ++image) {
    if (options.image_fixed[image]) fixed_body[body_of(static_cast<int>(image))] = 1;
  }
  // Points are eliminated first. Each array is a group of its own: within a group Ceres goes by
  // addresses, which differ from run to run between arrays, and so would the last bits.
  enum Group { kPoints, kPoses, kVelocities, kMounts, kLenses };  // and one more for each lens
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (int body = 0; body < state.num_bodies(); ++body) {
    if (!used_body[body]) continue;
    double* pose = state.poses[body].data();
    ordering->AddElementToGroup(pose, kPoses);
    problem.SetManifold(pose, body == scale_body ? &scaled_pose : &free_pose);
    if (body == gauge_body || fixed_body[body]) problem.SetParameterBlockConstant(pose);
    if (state.velocities.empty()) continue;
    double* velocity = state.velocities[body].data();
    ordering->AddElementToGroup(velocity, kVelocities);
    if (fixed_body[body]) {
      problem.SetParameterBlockConstant(velocity);
    } else if (!options.velocity_priors.empty()) {
      const VelocityPrior& prior = options.velocity_priors[state.image_of_body[body]];
      problem.AddResidualBlock(new VelocityCost(prior, options.noise), nullptr, velocity);
    }
  }
  for (std::size_t i = 0; i < state.points.size(); ++i) {
    if (!used_point[i]) continue;
    ordering->AddElementToGroup(state.points[i].data(), kPoints);
    if (Flag(options.point_fixed, static_cast<int>(i))) {
      problem.SetParameterBlockConstant(state.points[i].data());
    }
  }
  for (std::size_t m = 0; m < state.mounts.size(); ++m) {
    if (!used_mount[m]) continue;
    double* mount = state.mounts[m].data();
    ordering->AddElementToGroup(mount, kMounts);
    problem.SetManifold(mount, &free_pose);
    if (!Flag(options.mount_free, static_cast<int>(m))) problem.SetParameterBlockConstant(mount);
  }
  for (std::size_t c = 0; c < state.lenses.size(); ++c) {
    if (!used_lens[c]) continue;
    std::vector<double>& lens = state.lenses[c];
    ordering->AddElementToGroup(lens.data(), kLenses + static_cast<int>(c));
    std::vector<int> held;
    for (std::size_t k = 0; k < lens.size(); ++k) {
      if (!options.lens_free[c][k]) held.push_back(static_cast<int>(k));
    }
    if (held.size() == lens.size()) {
      problem.SetParameterBlockConstant(lens.data());
    } else if (!held.empty()) {
      lens_manifolds.push_back(
          std::make_unique<ceres::SubsetManifold>(static_cast<int>(lens.size()), held));
      problem.SetManifold(lens.data(), lens_manifolds.back().get());
    }
  }
  ceres::Solver::Options solver;
  solver.linear_solver_ordering = ordering;
  summary.dense = IsDense(*bundle, state);
  solver.linear_solver_type = summary.dense ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = options.function_tolerance;
  solver.num_threads = std::max(1, options.num_threads);
  solver.logging_type = ceres::SILENT;
  if (evaluation) evaluation->PrepareForEvaluation(false, true);
  summary.rms_before = Rms(*bundle, state, evaluation.get());
  ceres::Solver::Summary words;
  {
    const QuietSolver quiet;  // a step that fails is tried again shorter: nothing to tell
    ceres::Solve(solver, &problem, &words);
  }
  if (!words.IsSolutionUsable()) {
    throw SolveError("bundle adjustment failed: " + words.message);
  }
  if (evaluation) evaluation->PrepareForEvaluation(false, true);
  summary.rms_after = Rms(*bundle, state, evaluation.get());
  summary.num_outside = evaluation ? evaluation->NumOutside() : 0;
  summary.iterations = static_cast<int>(words.iterations.size()) - 1;
  summary.converged = words.termination_type == ceres::CONVERGENCE;
  for (std::size_t i = 0; i < bundle->camera_from_world.size(); ++i) {
    const int image = static_cast<int>(i);
    const int body = body_of(image);
    if (!used_body[body]) continue;
    if (!bundle->velocities.empty()) bundle->velocities[i] = state.velocities[body];
    // A pose that stayed keeps its digits; other cameras of its body follow it.
    const bool stays = (body == gauge_body || fixed_body[body]) &&
                       state.image_of_body[body] == image && state.mount_of_image[image] < 0;
    if (!stays) bundle->camera_from_world[i] = state.CameraFromWorld(image);
  }
  for (std::size_t m = 0; m < state.mounts.size(); ++m) {
    if (used_mount[m] && Flag(options.mount_free, static_cast<int>(m))) {
      bundle->camera_from_body[m] = FromBlock(state.mounts[m]);
    }
  }
  bundle->points = state.points;
  for (std::size_t c = 0; c < state.lenses.size(); ++c) {
    if (!used_lens[c]) continue;
    const Camera& camera = bundle->cameras[c];
    bundle->cameras[c] = Camera(camera.model(), state.lenses[c], camera.width(), camera.height(),
                                camera.valid_field_angle());
  }
  return summary;
}

}  // namespace gsut
