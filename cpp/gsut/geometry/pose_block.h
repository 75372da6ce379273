// A pose as a solver sees it: quaternion and centre, changed by a turn from the left and a shift.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>

#include "gsut/geometry/pose.h"

namespace gsut {

// (x, y, z, w, centre in the world): p = R (X - centre). The tangent is (centre, turn) with
// R <- exp(turn) R. Cost functions give their derivatives by the tangent, in the first columns of
// the block: the Jacobian of PoseManifold (sfm) is written to match, and is no derivative by
// itself.
using PoseBlock = std::array<double, 7>;
inline constexpr int kPoseTangent = 6;

inline PoseBlock ToBlock(const Pose& pose) {
  PoseBlock block;
  Eigen::Map<Eigen::Quaterniond>(block.data()) = Eigen::Quaterniond(pose.rotation).normalized();
  Eigen::Map<Eigen::Vector3d>(block.data() + 4) = pose.CenterInSource();
  return block;
}

inline Eigen::Matrix3d RotationOf(const double* block) {
  return Eigen::Map<const Eigen::Quaterniond>(block).toRotationMatrix();
}

inline Eigen::Vector3d CenterOf(const double* block) {
  return Eigen::Map<const Eigen::Vector3d>(block + 4);
}

inline Pose FromBlock(const PoseBlock& block) {
  Pose pose;
  pose.rotation = RotationOf(block.data());
  pose.translation = -(pose.rotation * CenterOf(block.data()));
  return pose;
}

// dp/d(centre, turn) of p = R (X - centre), times dout_dp: (rows, 6).
template <int kRows>
Eigen::Matrix<double, kRows, kPoseTangent> ByPose(const Eigen::Matrix<double, kRows, 3>& dout_dp,
                                                  const Eigen::Matrix3d& rotation,
                                                  const Eigen::Vector3d& p) {
  Eigen::Matrix<double, kRows, kPoseTangent> jacobian;
  jacobian.template leftCols<3>() = -(dout_dp * rotation);
  jacobian.col(3) = dout_dp * Eigen::Vector3d(0, -p.z(), p.y());
  jacobian.col(4) = dout_dp * Eigen::Vector3d(p.z(), 0, -p.x());
  jacobian.col(5) = dout_dp * Eigen::Vector3d(-p.y(), p.x(), 0);
  return jacobian;
}

}  // namespace gsut
