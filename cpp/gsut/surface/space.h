// The grid of the voxels, and where its points lie in the world.
#pragma once

#include <Eigen/Core>
#include <limits>

namespace gsut {

// Grid coordinates count voxels from `center`. Up to `inner` voxels from it the grid is even;
// beyond (an open scene) space is contracted, so that all of it lies within 2 inner: a point at the
// distance x > inner (in voxels) lies at inner (2 - inner / x) (Mip-NeRF 360, eq. 10). Voxels then
// grow with the square of the distance along it and with the distance across.
struct VoxelSpace {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  double voxel = 1;  // world units, where the grid is even
  double inner = std::numeric_limits<double>::infinity();

  // The grid ends here, 50 times `inner` away.
  static constexpr double kEnd = 1.98;

  Eigen::Vector3d GridOf(const Eigen::Vector3d& world) const {
    const Eigen::Vector3d g = (world - center) / voxel;
    const double x = g.norm();
    return x <= inner ? g : Eigen::Vector3d(g * (inner * (2.0 - inner / x) / x));
  }
  // About `center`, world units.
  Eigen::Vector3d AboutCenter(const Eigen::Vector3d& grid) const {
    const double r = grid.norm();
    return r <= inner ? Eigen::Vector3d(grid * voxel)
                      : Eigen::Vector3d(grid * (voxel * inner / (2.0 - r / inner) / r));
  }
  // World units that a voxel is long, away from the centre.
  double VoxelAt(const Eigen::Vector3d& grid) const {
    const double r = grid.norm();
    if (r <= inner) return voxel;
    const double left = 2.0 - r / inner;
    return voxel / (left * left);
  }
  bool Holds(const Eigen::Vector3d& grid) const { return grid.norm() < kEnd * inner; }
};

}  // namespace gsut
