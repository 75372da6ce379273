// A Gaussian in the frame of a camera, and how it gets there in double.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "gsut/gaussians/activations.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/geometry/pose.h"

namespace gsut {

// axes[k] are unit vectors, scale[k] the standard deviations along them.
template <class T>
struct PlacedGaussian {
  T mean[3], axes[3][3], scale[3];
};

template <class T>
PlacedGaussian<double> PlaceInDouble(const GaussiansView<const T>& gaussians, std::int64_t i,
                                     const Pose& camera_from_world) {
  const Eigen::Vector3d mean =
      camera_from_world.rotation * Eigen::Map<const Eigen::Matrix<T, 3, 1>>(gaussians.means + 3 * i)
                                       .template cast<double>() +
      camera_from_world.translation;
  double quat[4], r[9];
  for (int k = 0; k < 4; ++k) quat[k] = static_cast<double>(gaussians.quats[4 * i + k]);
  RotationFromQuaternion(quat, r);
  const Eigen::Matrix3d q = camera_from_world.rotation *
                            Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r);
  PlacedGaussian<double> out;
  for (int k = 0; k < 3; ++k) {
    out.mean[k] = mean[k];
    out.scale[k] = gaussians.Scale(i, k);
    for (int row = 0; row < 3; ++row) out.axes[k][row] = q(row, k);
  }
  return out;
}

}  // namespace gsut
