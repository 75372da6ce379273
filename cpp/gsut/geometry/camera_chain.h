// A point in a camera that moves while its image is read, or that is mounted on a body: value and
// derivatives.
#pragma once

#include <Eigen/Core>

#include "gsut/geometry/pose.h"

namespace gsut {

// (velocity of the centre in the world, turn in the frame of the body), both for a whole readout.
using Velocity = Eigen::Matrix<double, 6, 1>;

// The unknowns that carry a point X of the world into a camera:
//   q = exp(time w) R (X - centre - time v),  p = R_mount (q - centre_mount).
// Blocks as in pose_block.h; null: stands still, is the body itself.
struct CameraChain {
  const double* pose = nullptr;      // of the body in the middle of the readout
  const double* velocity = nullptr;  // (v, w), see Velocity
  const double* mount = nullptr;     // camera_from_body
  double time = 0.0;                 // when the line is read: -0.5 first, 0.5 last edge

  // camera_from_world at that time.
  Pose CameraFromWorld() const;
  Eigen::Vector3d Point(const Eigen::Vector3d& in_world) const;
};

// dout_dp (2, 3), the derivative by p, carried on to the unknowns; tangents as in pose_block.h.
struct ChainDerivatives {
  Eigen::Matrix<double, 2, 6> by_pose, by_velocity, by_mount;
  Eigen::Matrix<double, 2, 3> by_point;
};
ChainDerivatives Derivatives(const CameraChain& chain, const Eigen::Vector3d& in_world,
                             const Eigen::Matrix<double, 2, 3>& dout_dp);

// camera_from_world of a camera on a body at camera_from_world `middle`, at a time of its readout.
Pose MovedPose(const Pose& middle, const Velocity& velocity, double time);

// The velocity with which a camera goes from one pose to the other, the middle being halfway.
Velocity VelocityBetween(const Pose& start, const Pose& end);

}  // namespace gsut
