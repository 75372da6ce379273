// Exponential and logarithm of rotations, with the left Jacobian.
#include "gsut/geometry/rotation_vector.h"

#include <Eigen/Geometry>
#include <cmath>

#include "gsut/geometry/pose.h"

namespace gsut {
namespace {

// Below this angle the series of the left Jacobian is exact to double.
constexpr double kSmallAngle = 1e-3;

}  // namespace

Eigen::Matrix3d Skew(const Eigen::Vector3d& w) {
  Eigen::Matrix3d m;
  m << 0, -w.z(), w.y(), w.z(), 0, -w.x(), -w.y(), w.x(), 0;
  return m;
}

Eigen::Matrix3d RotationOfVector(const Eigen::Vector3d& w) {
  Eigen::Matrix<double, 6, 1> xi = Eigen::Matrix<double, 6, 1>::Zero();
  xi.tail<3>() = w;
  return ExpPose(xi).rotation;
}

// By the quaternion (cos t/2, sin t/2 axis), whose parts never cancel: the arccosine of the trace
// loses half of the digits near 0 and pi. q and -q are one rotation; w >= 0 takes the angle below
// pi.
Eigen::Vector3d VectorOfRotation(const Eigen::Matrix3d& rotation) {
  Eigen::Quaterniond q(rotation);
  q.normalize();
  if (q.w() < 0) q.coeffs() *= -1.0;
  const double sine = q.vec().norm();
  if (sine == 0.0) return Eigen::Vector3d::Zero();
  return q.vec() * (2.0 * std::atan2(sine, q.w()) / sine);
}

// exp(w + d) = exp(J(w) d) exp(w) to first order; J = I + b [w]x + c [w]x^2 as of ExpPose, with
// 1 - cos t = 2 sin^2(t/2), which does not cancel.
Eigen::Matrix3d LeftJacobian(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  const double a2 = angle * angle;
  const double b =
      angle < kSmallAngle ? 0.5 - a2 / 24.0 : 2.0 * std::pow(std::sin(0.5 * angle) / angle, 2);
  const double c =
      angle < kSmallAngle ? 1.0 / 6.0 - a2 / 120.0 : (angle - std::sin(angle)) / (a2 * angle);
  const Eigen::Matrix3d k = Skew(w);
  return Eigen::Matrix3d::Identity() + b * k + c * k * k;
}

// I - [w]x / 2 + (1 - t/2 cot(t/2)) / t^2 [w]x^2.
Eigen::Matrix3d InverseLeftJacobian(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  const double a2 = angle * angle;
  const double half = 0.5 * angle;
  const double c = angle < kSmallAngle ? 1.0 / 12.0 + a2 / 720.0
                                       : (1.0 - half * std::cos(half) / std::sin(half)) / a2;
  const Eigen::Matrix3d k = Skew(w);
  return Eigen::Matrix3d::Identity() - 0.5 * k + c * k * k;
}

}  // namespace gsut
