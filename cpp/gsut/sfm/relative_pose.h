// The pose of one camera seen from another, from matched bearings; any lens, any field of view.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "gsut/sfm/bearing.h"
#include "gsut/geometry/pose.h"

namespace gsut {

struct RelativePoseOptions {
  double max_error = 2.0;  // pixels: Sampson error up to which a match is an inlier
  int max_samples = 600;   // of RANSAC
  std::uint64_t seed = 0;
};

struct RelativePose {
  Pose second_from_first;             // |translation| = 1
  std::vector<std::uint8_t> inliers;  // one a match
  int num_inliers = 0;
  // Number of inliers that a rotation alone explains within the same error: if these are most of
  // them, the direction of the translation means little.
  int num_rotation_inliers = 0;
  double parallax =
      0.0;  // radians: upper quartile of the angle between matched rays, rotation undone
  bool found = false;
};

// Epipolar error of a match, in pixels, to first order: |b2 E b1| over the root of the sum of the
// squared derivatives by both pixels (Sampson's), through each lens.
double EpipolarError(const Eigen::Matrix3d& essential, const Bearing& first, const Bearing& second);

// E = [t]x R.
Eigen::Matrix3d EssentialMatrix(const Pose& second_from_first);

// LO-RANSAC over FivePoint: the best sample is refined on its inliers by Gauss-Newton on the
// Sampson error, and the one of its four decompositions is taken that puts most points in front,
// along the rays. The same result for the same seed on any thread.
// Samples are drawn from the first few matches, then from more and more of them (as PROSAC does):
// put the best first.
// Args: first, second: the matched bearings, of the same length.
RelativePose EstimateRelativePose(std::span<const Bearing> first, std::span<const Bearing> second,
                                  const RelativePoseOptions& options);

}  // namespace gsut
