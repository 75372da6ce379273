// The pose of a camera that sees known points.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "gsut/sfm/bearing.h"
#include "gsut/geometry/pose.h"

namespace gsut {

struct AbsolutePoseOptions {
  double max_error = 4.0;  // pixels up to which a point is an inlier
  int max_samples = 2000;  // of RANSAC
  std::uint64_t seed = 0;
};

struct AbsolutePose {
  Pose camera_from_world;
  std::vector<std::uint8_t> inliers;  // one a point
  int num_inliers = 0;                // 0: no pose was found
};

// LO-RANSAC over ThreePoint, refined on the inliers by Gauss-Newton on their residuals in pixels.
// Args: bearings and the points in the world that they see, of the same length.
AbsolutePose EstimateAbsolutePose(std::span<const Bearing> bearings,
                                  std::span<const Eigen::Vector3d> points,
                                  const AbsolutePoseOptions& options);

// Gauss-Newton on the residuals below max_error (truncated squares), from a pose nearby.
Pose RefineAbsolutePose(const Pose& camera_from_world, std::span<const Bearing> bearings,
                        std::span<const Eigen::Vector3d> points, double max_error);

}  // namespace gsut
