// Minimal solvers: essential matrices of five pairs of bearings, poses of three bearings.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "gsut/geometry/pose.h"

namespace gsut {

// All real E with ray2^T E ray1 = 0 for the five pairs, det E = 0 and 2 E E^T E = tr(E E^T) E; at
// most 10, of Frobenius norm sqrt(2). Rays may point anywhere on the sphere. Degenerate input gives
// few or meaningless ones: the caller counts inliers.
// Source: Stewenius, Engels, Nister, "Recent developments on direct relative orientation", 2006
// (the null space's combinations, their ten cubics, eigenvectors of the action matrix).
std::vector<Eigen::Matrix3d> FivePoint(const std::array<Eigen::Vector3d, 5>& rays1,
                                       const std::array<Eigen::Vector3d, 5>& rays2);

// All camera_from_world (at most 4) that see the three points in front along the unit rays, which
// may point anywhere on the sphere. None for collinear points or equal rays.
// Source: Haralick, Lee, Ottenberg, Noelle, "Review and analysis of solutions of the three point
// perspective pose estimation problem", 1994 (Grunert's quartic); the depths are then polished by
// Newton's method on the three laws of cosines.
std::vector<Pose> ThreePoint(const std::array<Eigen::Vector3d, 3>& rays,
                             const std::array<Eigen::Vector3d, 3>& points);

}  // namespace gsut
