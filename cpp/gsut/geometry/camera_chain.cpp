// The chain world -> moving body -> mounted camera, and its derivatives.
#include "gsut/geometry/camera_chain.h"

#include "gsut/geometry/pose_block.h"
#include "gsut/geometry/rotation_vector.h"

namespace gsut {
namespace {

struct Body {
  Eigen::Matrix3d rotation;  // at the time
  Eigen::Vector3d center;
  Eigen::Matrix3d turn;  // exp(time w); not set if it stands still
};

Body BodyAt(const CameraChain& chain) {
  Body body = {RotationOf(chain.pose), CenterOf(chain.pose), {}};
  if (chain.velocity != nullptr) {
    const Eigen::Map<const Velocity> velocity(chain.velocity);
    body.turn = RotationOfVector(chain.time * velocity.tail<3>());
    body.rotation = body.turn * body.rotation;
    body.center += chain.time * velocity.head<3>();
  }
  return body;
}

}  // namespace

Pose CameraChain::CameraFromWorld() const {
  const Body body = BodyAt(*this);
  Pose result;
  result.rotation = body.rotation;
  result.translation = -(body.rotation * body.center);
  if (mount == nullptr) return result;
  Pose camera_from_body;
  camera_from_body.rotation = RotationOf(mount);
  camera_from_body.translation = -(camera_from_body.rotation * CenterOf(mount));
  return camera_from_body * result;
}

Eigen::Vector3d CameraChain::Point(const Eigen::Vector3d& in_world) const {
  const Body body = BodyAt(*this);
  const Eigen::Vector3d q = body.rotation * (in_world - body.center);
  return mount == nullptr ? q : RotationOf(mount) * (q - CenterOf(mount));
}

// p = R_m (q - c_m),  q = exp(t w) R (X - c - t v). From the outside in, each factor takes the
// derivative by what it made and gives that by what it took:
//   dp/dq = R_m,  dq/dX = exp(t w) R,  dq/dv = -t dq/dX,
//   dq/dw = -[q]x t J(t w), with J the left Jacobian: exp(t (w + d)) = exp(t J d) exp(t w) to first
//   order.
ChainDerivatives Derivatives(const CameraChain& chain, const Eigen::Vector3d& in_world,
                             const Eigen::Matrix<double, 2, 3>& dout_dp) {
  ChainDerivatives out;
  const Body body = BodyAt(chain);
  const Eigen::Vector3d q = body.rotation * (in_world - body.center);
  Eigen::Matrix<double, 2, 3> dout_dq = dout_dp;
  if (chain.mount != nullptr) {
    const Eigen::Matrix3d rotation = RotationOf(chain.mount);
    out.by_mount = ByPose<2>(dout_dp, rotation, rotation * (q - CenterOf(chain.mount)));
    dout_dq = dout_dp * rotation;
  }
  out.by_point = dout_dq * body.rotation;
  out.by_pose = ByPose<2>(dout_dq, body.rotation, q);
  if (chain.velocity == nullptr) return out;
  // A turn of the pose stands to the right of exp(time w): it reaches q turned by that.
  const double t = chain.time;
  const Eigen::Vector3d w = t * Eigen::Map<const Velocity>(chain.velocity).tail<3>();
  const Eigen::Matrix<double, 2, 3> by_turn = out.by_pose.rightCols<3>();
  out.by_pose.rightCols<3>() = by_turn * body.turn;
  out.by_velocity.leftCols<3>() = -t * out.by_point;
  out.by_velocity.rightCols<3>() = t * by_turn * LeftJacobian(w);
  return out;
}

Pose MovedPose(const Pose& middle, const Velocity& velocity, double time) {
  Pose moved;
  moved.rotation = RotationOfVector(time * velocity.tail<3>()) * middle.rotation;
  moved.translation = -(moved.rotation * (middle.CenterInSource() + time * velocity.head<3>()));
  return moved;
}

// The inverse of MovedPose over a unit of time.
Velocity VelocityBetween(const Pose& start, const Pose& end) {
  Velocity velocity;
  velocity << end.CenterInSource() - start.CenterInSource(),
      VectorOfRotation(end.rotation * start.rotation.transpose());
  return velocity;
}

}  // namespace gsut
