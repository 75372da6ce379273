// Rigid transforms in double.
#include "gsut/geometry/pose.h"

#include <cmath>
#include <sstream>

#include "gsut/base/errors.h"
#include "gsut/geometry/rotation_vector.h"

namespace gsut {
namespace {

// Largest |R^T R - I| accepted: files print rotations with as few as five digits.
constexpr double kRotationTolerance = 1e-4;

}  // namespace

Pose Pose::FromMatrix(const Eigen::Matrix4d& m) {
  if (!m.allFinite()) throw InputError("pose matrix holds a value that is not finite");
  if (m.row(3) != Eigen::RowVector4d(0, 0, 0, 1)) {
    std::ostringstream message;
    message << "the last row of a pose matrix must be 0 0 0 1, found " << m.row(3);
    throw InputError(message.str());
  }
  const Eigen::Matrix3d r = m.topLeftCorner<3, 3>();
  const double deviation = (r.transpose() * r - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(deviation <= kRotationTolerance) || r.determinant() < 0) {
    std::ostringstream message;
    message << "the pose is not a rotation: |R^T R - I| is " << deviation << " (at most "
            << kRotationTolerance << "), determinant " << r.determinant()
            << " (must be +1); remove scale, shear and mirroring from the matrix";
    throw InputError(message.str());
  }
  Pose pose;
  // Through a unit quaternion: the result is orthogonal to rounding, however few digits came in.
  pose.rotation = Eigen::Quaterniond(r).normalized().toRotationMatrix();
  // A matrix that is exact to double keeps its digits: the quaternion is only used where it helps.
  constexpr double kExact = 1e-12;  // a few hundred units in the last place of an entry
  if (deviation < kExact) pose.rotation = r;
  pose.translation = m.topRightCorner<3, 1>();
  return pose;
}

Eigen::Matrix4d Pose::Matrix() const {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  m.topLeftCorner<3, 3>() = rotation;
  m.topRightCorner<3, 1>() = translation;
  return m;
}

Pose Pose::Inverse() const {
  Pose inverse;
  inverse.rotation = rotation.transpose();
  inverse.translation = CenterInSource();
  return inverse;
}

Pose Pose::operator*(const Pose& other) const {
  Pose product;
  product.rotation = rotation * other.rotation;
  product.translation = rotation * other.translation + translation;
  return product;
}

// Slerp of rotations; translations, not centres, change linearly.
Pose Interpolate(const Pose& start, const Pose& end, double t) {
  const Eigen::Quaterniond a(start.rotation);
  const Eigen::Quaterniond b(end.rotation);
  Pose pose;
  pose.rotation = a.slerp(t, b).toRotationMatrix();
  pose.translation = (1.0 - t) * start.translation + t * end.translation;
  return pose;
}

// Rodrigues' formula, and the translation V v that belongs to it:
//   exp([w]x) = I + a [w]x + b [w]x^2,   V = I + b [w]x + c [w]x^2,
//   a = sin(t) / t,  b = (1 - cos(t)) / t^2,  c = (t - sin(t)) / t^3,  t = |w|.
// For small t numerators cancel, and two terms of the series are exact.
Pose ExpPose(const Eigen::Matrix<double, 6, 1>& xi) {
  const Eigen::Vector3d v = xi.head<3>();
  const Eigen::Vector3d w = xi.tail<3>();
  const double angle = w.norm();
  const Eigen::Matrix3d k = Skew(w);
  const Eigen::Matrix3d k2 = k * k;
  // Below this angle the series is exact to double.
  constexpr double kSmallAngle = 1e-4;
  const double a2 = angle * angle;
  const double a = angle < kSmallAngle ? 1.0 - a2 / 6.0 : std::sin(angle) / angle;
  const double b = angle < kSmallAngle ? 0.5 - a2 / 24.0 : (1.0 - std::cos(angle)) / a2;
  const double c = angle < kSmallAngle ? 1.0 / 6.0 - a2 / 120.0 : (1.0 - a) / a2;
  Pose pose;
  pose.rotation = Eigen::Matrix3d::Identity() + a * k + b * k2;
  pose.translation = v + b * (k * v) + c * (k2 * v);
  return pose;
}

}  // namespace gsut
