// Rays of features and the residual of a point against one, in pixels.
#include "gsut/sfm/bearing.h"

#include <Eigen/LU>
#include <cmath>
#include <limits>

namespace gsut {

std::vector<Bearing> MakeBearings(const Camera& camera, std::span<const Eigen::Vector2d> pixels,
                                  std::vector<std::uint8_t>* valid) {
  const auto count = static_cast<std::int64_t>(pixels.size());
  std::vector<double> rays(3 * count), again(2 * count), jacobians(6 * count);
  std::vector<std::uint8_t> inside(count);
  valid->assign(count, 0);
  std::vector<Bearing> bearings(count);
  if (count == 0) return bearings;
  camera.Unproject(count, pixels[0].data(), rays.data(), valid->data());
  camera.ProjectJacobian(count, rays.data(), again.data(), inside.data(), jacobians.data(),
                         nullptr);
  for (std::int64_t i = 0; i < count; ++i) {
    (*valid)[i] = (*valid)[i] && inside[i];
    if (!(*valid)[i]) continue;
    Bearing& bearing = bearings[i];
    bearing.ray = Eigen::Map<const Eigen::Vector3d>(&rays[3 * i]);
    bearing.dpixel_dray =
        Eigen::Map<const Eigen::Matrix<double, 2, 3, Eigen::RowMajor>>(&jacobians[6 * i]);
    // dray_dpixel is the pseudo-inverse J^T (J J^T)^-1: a pixel moves the ray across itself only.
    const Eigen::Matrix2d gram = bearing.dpixel_dray * bearing.dpixel_dray.transpose();
    bearing.dray_dpixel = bearing.dpixel_dray.transpose() * gram.inverse();
    (*valid)[i] = gram.determinant() > 0.0 && bearing.dray_dpixel.allFinite();
  }
  return bearings;
}

// With q the unit vector to the point and J = dpixel_dray (J ray = 0), J q is to first order how
// far the point's pixel is from the feature's. |J q| alone would fall again beyond 90 degrees;
// divided by cos^2 of half the angle, 2 / (1 + ray . q), it rises up to 180, so a point behind the
// camera never looks right.
Eigen::Vector2d BearingResidual(const Bearing& bearing, const Eigen::Vector3d& point_in_camera) {
  const double length = point_in_camera.norm();
  const Eigen::Vector3d q = point_in_camera / length;
  const double scale = 2.0 / (1.0 + bearing.ray.dot(q));
  Eigen::Vector2d residual = scale * (bearing.dpixel_dray * q);
  if (!residual.allFinite()) residual.setConstant(std::numeric_limits<double>::infinity());
  return residual;
}

Eigen::Vector2d BearingResidual(const Bearing& bearing, const Eigen::Vector3d& point_in_camera,
                                Eigen::Matrix<double, 2, 3>* dresidual_dpoint) {
  const double over_length = 1.0 / point_in_camera.norm();
  const Eigen::Vector3d q = over_length * point_in_camera;
  const double scale = 2.0 / (1.0 + bearing.ray.dot(q));
  const Eigen::Vector2d image = bearing.dpixel_dray * q;
  // d(s J q)/dq = s J + J q ds/dq with ds/dq = -s^2 / 2 ray^T; then q = p / |p| projects across q.
  const Eigen::Matrix<double, 2, 3> dresidual_dq =
      scale * bearing.dpixel_dray - (0.5 * scale * scale) * image * bearing.ray.transpose();
  *dresidual_dpoint = over_length * (dresidual_dq - (dresidual_dq * q) * q.transpose());
  return scale * image;
}

}  // namespace gsut
