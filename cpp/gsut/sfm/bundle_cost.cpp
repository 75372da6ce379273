// Residuals of observations and priors, and their derivatives by the solver's blocks.
#include "gsut/sfm/bundle_cost.h"

#include <algorithm>

namespace gsut {
namespace {

constexpr int kPoseSize = 7, kPointSize = 3, kVelocitySize = 6;
using RowMajor23 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
using RowMajor26 = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;
using RowMajor27 = Eigen::Matrix<double, 2, kPoseSize, Eigen::RowMajor>;

// The tangent's derivatives in the first columns, see PoseManifold.
void WritePoseJacobian(const Eigen::Matrix<double, 2, 6>& by_pose, double* out) {
  Eigen::Map<RowMajor27> matrix(out);
  matrix.leftCols<6>() = by_pose;
  matrix.col(6).setZero();
}

}  // namespace

ReprojectionCost::ReprojectionCost(const Bundle& bundle, const BundleState& state, int index,
                                   const LensEvaluation* lenses, bool lens_free)
    : observation_(bundle.observations[index]),
      body_(state.body_of_image[observation_.image]),
      mount_(state.mount_of_image[observation_.image]),
      camera_(bundle.camera_of_image[observation_.image]),
      index_(index),
      lenses_(lenses) {
  set_num_residuals(2);
  std::vector<int>& sizes = *mutable_parameter_block_sizes();
  sizes = {kPoseSize, kPointSize};
  const auto add = [&](int size) {
    sizes.push_back(size);
    return static_cast<int>(sizes.size()) - 1;
  };
  if (!state.velocities.empty()) velocity_place_ = add(kVelocitySize);
  if (mount_ >= 0) mount_place_ = add(kPoseSize);
  if (lens_free) {
    num_lens_ = bundle.cameras[camera_].num_params();
    lens_place_ = add(num_lens_);
  }
}

std::vector<double*> ReprojectionCost::Blocks(BundleState* state) const {
  std::vector<double*> blocks = {state->poses[body_].data(),
                                 state->points[observation_.point].data()};
  if (velocity_place_ >= 0) blocks.push_back(state->velocities[body_].data());
  if (mount_place_ >= 0) blocks.push_back(state->mounts[mount_].data());
  if (lens_place_ >= 0) blocks.push_back(state->lenses[camera_].data());
  return blocks;
}

bool ReprojectionCost::Evaluate(double const* const* parameters, double* residuals,
                                double** jacobians) const {
  LensEvaluation::Row row = {};
  if (lenses_ != nullptr) row = lenses_->Get(index_);
  if (row.lens_failed) return false;
  const CameraChain chain = {
      parameters[0], velocity_place_ < 0 ? nullptr : parameters[velocity_place_],
      mount_place_ < 0 ? nullptr : parameters[mount_place_], observation_.time};
  const Eigen::Vector3d point = Eigen::Map<const Eigen::Vector3d>(parameters[1]);
  Eigen::Matrix<double, 2, 3> by_p;
  Eigen::Map<Eigen::Vector2d> residual(residuals);
  if (row.valid) {
    residual = Eigen::Map<const Eigen::Vector2d>(row.pixel) - observation_.pixel;
    if (jacobians != nullptr) by_p = Eigen::Map<const RowMajor23>(row.dpixel_dpoint);
  } else {
    residual = BearingResidual(observation_.bearing, chain.Point(point), &by_p);
  }
  if (!residual.allFinite()) return false;
  if (jacobians == nullptr) return true;
  const ChainDerivatives by = Derivatives(chain, point, by_p);
  const auto wanted = [&](int place) { return place >= 0 && jacobians[place] != nullptr; };
  if (wanted(0)) WritePoseJacobian(by.by_pose, jacobians[0]);
  if (wanted(1)) Eigen::Map<RowMajor23>{jacobians[1]} = by.by_point;
  if (wanted(velocity_place_)) {
    Eigen::Map<RowMajor26>{jacobians[velocity_place_]} = by.by_velocity;
  }
  if (wanted(mount_place_)) WritePoseJacobian(by.by_mount, jacobians[mount_place_]);
  if (wanted(lens_place_)) {
    double* out = jacobians[lens_place_];
    if (row.valid) {
      std::copy_n(row.dpixel_dparams, 2 * num_lens_, out);
    } else {
      std::fill_n(out, 2 * num_lens_, 0.0);
    }
  }
  return true;
}

VelocityCost::VelocityCost(const VelocityPrior& prior, double noise)
    : mean_(prior.mean), weight_(noise * prior.sigma.cwiseInverse()) {
  set_num_residuals(kVelocitySize);
  *mutable_parameter_block_sizes() = {kVelocitySize};
}

bool VelocityCost::Evaluate(double const* const* parameters, double* residuals,
                            double** jacobians) const {
  Eigen::Map<Velocity>{residuals} =
      weight_.cwiseProduct(Eigen::Map<const Velocity>(parameters[0]) - mean_);
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>{jacobians[0]} = weight_.asDiagonal();
  }
  return true;
}

}  // namespace gsut
