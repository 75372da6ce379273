// Points of rays: depth is measured along each ray, so rays may point anywhere on the sphere.
#pragma once

#include <Eigen/Core>
#include <array>
#include <span>
#include <vector>

#include "gsut/sfm/bearing.h"
#include "gsut/geometry/pose.h"

namespace gsut {

// Depths along two rays of their nearest points; not finite for parallel rays.
std::array<double, 2> RayDepths(const Pose& second_from_first, const Eigen::Vector3d& ray1,
                                const Eigen::Vector3d& ray2);

// One observation of a point.
struct PosedBearing {
  const Bearing* bearing = nullptr;
  const Pose* camera_from_world = nullptr;
};

struct TriangulationOptions {
  double max_error = 4.0;    // pixels, of each observation that is kept
  double min_angle = 0.026;  // radians (1.5 degrees): largest angle between two kept rays, at least
};

struct TriangulatedPoint {
  Eigen::Vector3d point = Eigen::Vector3d::Zero();  // in the world
  std::vector<std::uint8_t> kept;                   // one an observation
  int num_kept = 0;                                 // 0: there is no such point
};

// Whether any two of the rays from the point to the chosen cameras are at least this far apart, in
// radians.
bool ReachesAngle(std::span<const PosedBearing> observations, std::span<const std::uint8_t> chosen,
                  const Eigen::Vector3d& point, double min_angle);

// Least squares of the residuals of the chosen observations, in pixels (Gauss-Newton).
// False if it does not converge to a finite point.
bool RefinePoint(std::span<const PosedBearing> observations, std::span<const std::uint8_t> chosen,
                 Eigen::Vector3d* point);

// The point on which most observations agree: tries pairs of observations, widest angles first, and
// refines the best hypothesis on its inliers. Needs two observations and the smallest angle.
TriangulatedPoint Triangulate(std::span<const PosedBearing> observations,
                              const TriangulationOptions& options);

}  // namespace gsut
