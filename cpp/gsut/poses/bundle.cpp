// Bundle adjustment by Ceres, with derivatives written out.
#include "gsut/poses/bundle.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>

#include "gsut/base/errors.h"
#include "gsut/poses/lens_evaluation.h"
#include "gsut/poses/pose_block.h"

namespace gsut {
namespace {

using RowMajor23 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
using RowMajor27 = Eigen::Matrix<double, 2, 7, Eigen::RowMajor>;

// More images than this make a dense reduced system slower than a sparse one.
constexpr int kMostDenseImages = 150;

// Writes the derivatives by pose and point of a residual with the derivative by p = R (X - centre).
void WriteJacobians(const Eigen::Matrix<double, 2, 3>& by_p, const Eigen::Matrix3d& rotation,
                    const Eigen::Vector3d& p, double* by_pose, double* by_point) {
  if (by_pose != nullptr) {
    Eigen::Map<RowMajor27> out(by_pose);
    out.leftCols<6>() = ByPose<2>(by_p, rotation, p);
    out.col(6).setZero();
  }
  if (by_point != nullptr) Eigen::Map<RowMajor23>{by_point} = by_p * rotation;
}

// The residual of Bearing. Parameters: pose block, point.
class BearingCost : public ceres::SizedCostFunction<2, 7, 3> {
 public:
  explicit BearingCost(const Bearing& bearing) : bearing_(bearing) {}
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::Matrix3d rotation = RotationOf(parameters[0]);
    const Eigen::Vector3d point = Eigen::Map<const Eigen::Vector3d>(parameters[1]);
    const Eigen::Vector3d p = rotation * (point - CenterOf(parameters[0]));
    Eigen::Matrix<double, 2, 3> by_p;
    const Eigen::Vector2d residual = BearingResidual(bearing_, p, &by_p);
    Eigen::Map<Eigen::Vector2d>{residuals} = residual;
    if (jacobians != nullptr) WriteJacobians(by_p, rotation, p, jacobians[0], jacobians[1]);
    return residual.allFinite();
  }

 private:
  const Bearing& bearing_;
};

// Pixel through the lens minus pixel seen. Parameters: pose block, point and, if free, the lens.
class PixelCost : public ceres::CostFunction {
 public:
  PixelCost(const BundleObservation& observation, int index, const LensEvaluation& lenses,
            int num_lens_params)
      : observation_(observation), index_(index), lenses_(lenses), num_lens_(num_lens_params) {
    set_num_residuals(2);
    *mutable_parameter_block_sizes() = {7, 3};
    if (num_lens_ > 0) mutable_parameter_block_sizes()->push_back(num_lens_);
  }
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const LensEvaluation::Row row = lenses_.Get(index_);
    if (row.lens_failed) return false;
    const Eigen::Matrix3d rotation = RotationOf(parameters[0]);
    const Eigen::Vector3d point = Eigen::Map<const Eigen::Vector3d>(parameters[1]);
    const Eigen::Vector3d p = rotation * (point - CenterOf(parameters[0]));
    Eigen::Matrix<double, 2, 3> by_p;
    Eigen::Map<Eigen::Vector2d> residual(residuals);
    if (row.valid) {
      residual = Eigen::Map<const Eigen::Vector2d>(row.pixel) - observation_.pixel;
      if (jacobians != nullptr) by_p = Eigen::Map<const RowMajor23>(row.dpixel_dpoint);
    } else {
      residual = BearingResidual(observation_.bearing, p, &by_p);
    }
    if (jacobians != nullptr) {
      WriteJacobians(by_p, rotation, p, jacobians[0], jacobians[1]);
      if (num_lens_ > 0 && jacobians[2] != nullptr) {
        if (row.valid) {
          std::copy_n(row.dpixel_dparams, 2 * num_lens_, jacobians[2]);
        } else {
          std::fill_n(jacobians[2], 2 * num_lens_, 0.0);
        }
      }
    }
    return residual.allFinite();
  }

 private:
  const BundleObservation& observation_;
  int index_;
  const LensEvaluation& lenses_;
  int num_lens_;
};

bool Flag(const std::vector<std::uint8_t>& flags, int index) {
  return !flags.empty() && flags[index] != 0;
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
  if (options.lens_free.empty()) return;
  if (!options.through_lens) throw InputError("lens_free needs through_lens");
  bool same = options.lens_free.size() == bundle.cameras.size();
  for (std::size_t c = 0; same && c < bundle.cameras.size(); ++c) {
    same = options.lens_free[c].empty() ||
           static_cast<int>(options.lens_free[c].size()) == bundle.cameras[c].num_params();
  }
  if (!same) throw InputError("lens_free must have one flag a parameter of each camera");
}

double Rms(const Bundle& bundle, const std::vector<PoseBlock>& poses,
           const std::vector<Eigen::Vector3d>& points, const LensEvaluation* lenses) {
  double sum = 0.0;
  for (std::size_t i = 0; i < bundle.observations.size(); ++i) {
    const BundleObservation& observation = bundle.observations[i];
    const double* pose = poses[observation.image].data();
    const LensEvaluation::Row row =
        lenses != nullptr ? lenses->Get(static_cast<int>(i)) : LensEvaluation::Row{};
    if (row.valid) {
      sum += (Eigen::Map<const Eigen::Vector2d>(row.pixel) - observation.pixel).squaredNorm();
    } else {
      sum += BearingResidual(observation.bearing,
                             RotationOf(pose) * (points[observation.point] - CenterOf(pose)))
                 .squaredNorm();
    }
  }
  return std::sqrt(sum / std::max<std::size_t>(1, bundle.observations.size()));
}

// The component of the second centre that is farthest from the first's.
int ScaleAxis(const Pose& first, const Pose& second) {
  int axis = 0;
  (second.CenterInSource() - first.CenterInSource()).cwiseAbs().maxCoeff(&axis);
  return axis;
}

}  // namespace

BundleSummary AdjustBundle(Bundle* bundle, const BundleOptions& options) {
  CheckBundle(*bundle, options);
  BundleSummary summary;
  if (bundle->observations.empty()) return summary;
  std::vector<PoseBlock> poses;
  for (const Pose& pose : bundle->camera_from_world) poses.push_back(ToBlock(pose));
  std::vector<Eigen::Vector3d> points = bundle->points;
  std::vector<std::vector<double>> lenses;
  for (const Camera& camera : bundle->cameras) lenses.push_back(camera.params());
  const bool lenses_free = !options.lens_free.empty();
  std::unique_ptr<LensEvaluation> evaluation;
  ceres::Problem::Options problem_options;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  if (options.through_lens) {
    evaluation = std::make_unique<LensEvaluation>(*bundle, poses, points, lenses, lenses_free);
    problem_options.evaluation_callback = evaluation.get();
  }
  ceres::CauchyLoss cauchy(options.loss_scale > 0 ? options.loss_scale : 1.0);
  ceres::LossFunction* loss = options.loss_scale > 0 ? &cauchy : nullptr;
  PoseManifold free_pose;
  const bool has_scale = options.gauge_image >= 0 && options.scale_image >= 0;
  PoseManifold scaled_pose(has_scale ? ScaleAxis(bundle->camera_from_world[options.gauge_image],
                                                 bundle->camera_from_world[options.scale_image])
                                     : -1);
  std::vector<std::unique_ptr<ceres::Manifold>> lens_manifolds;
  ceres::Problem problem(problem_options);
  std::vector<std::uint8_t> used_image(poses.size()), used_point(points.size()),
      used_lens(lenses.size());
  for (std::size_t i = 0; i < bundle->observations.size(); ++i) {
    const BundleObservation& observation = bundle->observations[i];
    const int camera = bundle->camera_of_image[observation.image];
    double* pose = poses[observation.image].data();
    double* point = points[observation.point].data();
    const bool lens_free = lenses_free && !options.lens_free[camera].empty();
    if (!options.through_lens) {
      problem.AddResidualBlock(new BearingCost(observation.bearing), loss, pose, point);
    } else {
      auto* cost = new PixelCost(observation, static_cast<int>(i), *evaluation,
                                 lens_free ? bundle->cameras[camera].num_params() : 0);
      if (lens_free) {
        problem.AddResidualBlock(cost, loss, pose, point, lenses[camera].data());
        used_lens[camera] = 1;
      } else {
        problem.AddResidualBlock(cost, loss, pose, point);
      }
    }
    used_image[observation.image] = used_point[observation.point] = 1;
  }
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (!used_image[i]) continue;
    const int image = static_cast<int>(i);
    double* pose = poses[i].data();
    ordering->AddElementToGroup(pose, 1);
    problem.SetManifold(pose,
                        has_scale && image == options.scale_image ? &scaled_pose : &free_pose);
    if (image == options.gauge_image || Flag(options.image_fixed, image)) {
      problem.SetParameterBlockConstant(pose);
    }
  }
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!used_point[i]) continue;
    ordering->AddElementToGroup(points[i].data(), 0);
    if (Flag(options.point_fixed, static_cast<int>(i))) {
      problem.SetParameterBlockConstant(points[i].data());
    }
  }
  for (std::size_t c = 0; c < lenses.size(); ++c) {
    if (!used_lens[c]) continue;
    ordering->AddElementToGroup(lenses[c].data(), 1);
    std::vector<int> held;
    for (std::size_t k = 0; k < lenses[c].size(); ++k) {
      if (!options.lens_free[c][k]) held.push_back(static_cast<int>(k));
    }
    if (held.size() == lenses[c].size()) {
      problem.SetParameterBlockConstant(lenses[c].data());
    } else if (!held.empty()) {
      lens_manifolds.push_back(
          std::make_unique<ceres::SubsetManifold>(static_cast<int>(lenses[c].size()), held));
      problem.SetManifold(lenses[c].data(), lens_manifolds.back().get());
    }
  }
  ceres::Solver::Options solver;
  solver.linear_solver_ordering = ordering;
  solver.linear_solver_type =
      poses.size() <= kMostDenseImages ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = options.function_tolerance;
  solver.num_threads = std::max(1, options.num_threads);
  solver.logging_type = ceres::SILENT;
  if (evaluation) evaluation->PrepareForEvaluation(false, true);
  summary.rms_before = Rms(*bundle, poses, points, evaluation.get());
  ceres::Solver::Summary words;
  ceres::Solve(solver, &problem, &words);
  if (!words.IsSolutionUsable()) {
    throw SolveError("bundle adjustment failed: " + words.message);
  }
  if (evaluation) evaluation->PrepareForEvaluation(false, true);
  summary.rms_after = Rms(*bundle, poses, points, evaluation.get());
  summary.num_outside = evaluation ? evaluation->NumOutside() : 0;
  summary.iterations = static_cast<int>(words.iterations.size()) - 1;
  summary.converged = words.termination_type == ceres::CONVERGENCE;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const bool fixed = static_cast<int>(i) == options.gauge_image ||
                       Flag(options.image_fixed, static_cast<int>(i));
    if (used_image[i] && !fixed) bundle->camera_from_world[i] = FromBlock(poses[i]);
  }
  bundle->points = points;
  for (std::size_t c = 0; c < lenses.size(); ++c) {
    if (!used_lens[c]) continue;
    const Camera& camera = bundle->cameras[c];
    bundle->cameras[c] = Camera(camera.model(), lenses[c], camera.width(), camera.height(),
                                camera.valid_field_angle());
  }
  return summary;
}

}  // namespace gsut
