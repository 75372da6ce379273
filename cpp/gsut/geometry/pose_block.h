// A pose as a solver sees it: quaternion and centre, changed by a turn from the left and a shift.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cmath>

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

// Changes a pose along its tangent.
inline void AddToPose(const Eigen::Matrix<double, kPoseTangent, 1>& change, PoseBlock* pose) {
  const Eigen::Vector3d turn = change.tail<3>();
  const double half = 0.5 * turn.norm();
  // sin(half) / (2 half), by its series where it would be 0 / 0.
  constexpr double kSmall = 1e-4;
  const double factor =
      half < kSmall ? 0.5 * (1.0 - half * half / 6.0) : 0.5 * std::sin(half) / half;
  const Eigen::Quaterniond step(std::cos(half), factor * turn.x(), factor * turn.y(),
                                factor * turn.z());
  Eigen::Map<Eigen::Quaterniond> rotation(pose->data());
  rotation = (step * rotation).normalized();
  Eigen::Map<Eigen::Vector3d>(pose->data() + 4) += change.head<3>();
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
