// A feature as structure from motion sees it: a ray, and what a pixel is worth around it.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <span>
#include <vector>

#include "gsut/cameras/camera.h"

namespace gsut {

// The residual of a point p (in the camera frame) seen along the bearing is, in pixels,
//   r(p) = 2 / (1 + ray . q) dpixel_dray q,  q = p / |p|:
// the stereographic image of q around the ray, through the lens' derivative there. It has the value
// 0 and the derivative of the true reprojection error at p = ray, grows with the angle up to 180
// degrees, and needs no evaluation of the lens. (dpixel_dray ray = 0: a lens sees directions.)
struct Bearing {
  Eigen::Vector3d ray = Eigen::Vector3d::UnitZ();  // unit length
  Eigen::Matrix<double, 2, 3> dpixel_dray = {};    // at the ray
  Eigen::Matrix<double, 3, 2> dray_dpixel = {};    // its pseudo-inverse
};

// Bearings of pixels through a lens. valid (one a pixel): whether the pixel has a ray and the lens
// a derivative there; where it is 0, the bearing means nothing.
std::vector<Bearing> MakeBearings(const Camera& camera, std::span<const Eigen::Vector2d> pixels,
                                  std::vector<std::uint8_t>* valid);

// The residual above, in pixels. Infinite at 180 degrees and where p is 0 or not finite.
Eigen::Vector2d BearingResidual(const Bearing& bearing, const Eigen::Vector3d& point_in_camera);

// The same with its derivative by the point.
Eigen::Vector2d BearingResidual(const Bearing& bearing, const Eigen::Vector3d& point_in_camera,
                                Eigen::Matrix<double, 2, 3>* dresidual_dpoint);

}  // namespace gsut
