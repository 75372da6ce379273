// Rigid transforms in double: camera_from_world and its algebra.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gsut {

// x_in_target = rotation * x_in_source + translation; called target_from_source at each use.
struct Pose {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  // From a 4x4 matrix; throws InputError if the last row is not 0 0 0 1, a value is not finite, or
  // the rotation is not orthonormal with determinant +1 to within 1e-4 (it is then
  // re-orthonormalised to double precision, since files carry rounded digits).
  static Pose FromMatrix(const Eigen::Matrix4d& target_from_source);
  Eigen::Matrix4d Matrix() const;
  Pose Inverse() const;
  // Where the origin of target lies in source coordinates: the camera centre of camera_from_world.
  Eigen::Vector3d CenterInSource() const { return -(rotation.transpose() * translation); }
  Pose operator*(const Pose& other) const;
};

// Translation interpolated linearly, rotation on the shortest great arc; t in [0, 1].
Pose Interpolate(const Pose& start, const Pose& end, double t);

// exp of a twist (v, w), the left perturbation:
// target_from_source <- ExpPose(xi) * target_from_source.
Pose ExpPose(const Eigen::Matrix<double, 6, 1>& xi);

}  // namespace gsut
