// What the nearest points say of the surface that a point lies in, by a k-d tree.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

namespace gsut {

// Neighbours that the first scale of a Gaussian is taken from (3DGS), and those that its plane is
// laid through.
inline constexpr int kSeedNeighbors = 3;
inline constexpr int kPlaneNeighbors = 9;

struct Neighborhood {
  // Mean to the three nearest other points, or to all others where there are fewer; 0 for a single
  // point. Duplicates of a point are other points at distance 0.
  double distance = 0.0;
  // World from a frame whose third axis is the normal of the plane through the point and its nine
  // nearest others; the identity where there are fewer, or where they lie in one line.
  Eigen::Quaterniond frame = Eigen::Quaterniond::Identity();
  // Root mean square of these points' distances from the plane over that along its shorter axis,
  // at most 1; 1 where there is no plane.
  double thickness = 1.0;
};

// Of each of `count` points (count, 3), which must be finite. O(count log count); parallel, the
// same bits on any number of threads. Exact to rounding in double.
std::vector<Neighborhood> FindNeighborhoods(const double* points, std::int64_t count);

}  // namespace gsut
