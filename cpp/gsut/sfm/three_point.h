// Camera poses of three bearings and the points that they see.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "gsut/geometry/pose.h"

namespace gsut {

// All camera_from_world (at most 4) that see the three points in front along the unit rays, which
// may point anywhere on the sphere. None for collinear points or equal rays.
// Source: Haralick, Lee, Ottenberg, Noelle, "Review and analysis of solutions of the three point
// perspective pose estimation problem", 1994 (Grunert's quartic); the depths are then polished by
// Newton's method on the three laws of cosines.
std::vector<Pose> ThreePoint(const std::array<Eigen::Vector3d, 3>& rays,
                             const std::array<Eigen::Vector3d, 3>& points);

}  // namespace gsut
