// Covariances of the poses of a bundle: the reduced normal equations, inverted.
#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "gsut/base/errors.h"
#include "gsut/poses/bundle.h"
#include "gsut/poses/pose_block.h"

namespace gsut {
namespace {

using Matrix6 = Eigen::Matrix<double, 6, 6>;
using Matrix63 = Eigen::Matrix<double, 6, 3>;

struct Linearized {
  int image;
  Eigen::Matrix<double, 2, 6> by_pose;
  Eigen::Matrix<double, 2, 3> by_point;
};

}  // namespace

std::vector<Matrix6> PoseCovariances(const Bundle& bundle, const BundleOptions& options) {
  const int images = static_cast<int>(bundle.camera_from_world.size());
  std::vector<std::vector<Linearized>> of_point(bundle.points.size());
  double sum = 0.0;
  for (const BundleObservation& observation : bundle.observations) {
    const Pose& pose = bundle.camera_from_world[observation.image];
    const Eigen::Vector3d p = pose.rotation * bundle.points[observation.point] + pose.translation;
    Eigen::Matrix<double, 2, 3> by_p;
    const Eigen::Vector2d residual = BearingResidual(observation.bearing, p, &by_p);
    const double squared = residual.squaredNorm();
    // The loss' weight, as in the normal equations of the last step.
    const double s = options.loss_scale;
    const double weight = s > 0 ? std::sqrt(1.0 / (1.0 + squared / (s * s))) : 1.0;
    sum += weight * weight * squared;
    of_point[observation.point].push_back({observation.image,
                                           weight * ByPose<2>(by_p, pose.rotation, p),
                                           weight * (by_p * pose.rotation)});
  }
  Eigen::MatrixXd reduced = Eigen::MatrixXd::Zero(6 * images, 6 * images);
  std::int64_t freedom = 2 * static_cast<std::int64_t>(bundle.observations.size());
  std::vector<Matrix63> cross;
  for (const auto& sights : of_point) {
    if (sights.empty()) continue;
    freedom -= 3;
    Eigen::Matrix3d by_point = Eigen::Matrix3d::Zero();
    cross.clear();
    for (const Linearized& sight : sights) {
      by_point += sight.by_point.transpose() * sight.by_point;
      cross.push_back(sight.by_pose.transpose() * sight.by_point);
      reduced.block<6, 6>(6 * sight.image, 6 * sight.image) +=
          sight.by_pose.transpose() * sight.by_pose;
    }
    const Eigen::Matrix3d inverse = by_point.inverse();
    if (!inverse.allFinite()) throw SolveError("a point of the bundle is not determined");
    for (std::size_t i = 0; i < sights.size(); ++i) {
      const Matrix63 scaled = cross[i] * inverse;
      for (std::size_t j = 0; j < sights.size(); ++j) {
        reduced.block<6, 6>(6 * sights[i].image, 6 * sights[j].image) -=
            scaled * cross[j].transpose();
      }
    }
  }
  // The unknowns that the gauge leaves.
  std::vector<int> free;
  int held = -1;
  if (options.gauge_image >= 0 && options.scale_image >= 0) {
    (bundle.camera_from_world[options.scale_image].CenterInSource() -
     bundle.camera_from_world[options.gauge_image].CenterInSource())
        .cwiseAbs()
        .maxCoeff(&held);
  }
  for (int image = 0; image < images; ++image) {
    const bool fixed = image == options.gauge_image ||
                       (!options.image_fixed.empty() && options.image_fixed[image]);
    for (int k = 0; k < 6 && !fixed; ++k) {
      if (!(image == options.scale_image && k == held)) free.push_back(6 * image + k);
    }
  }
  freedom -= static_cast<std::int64_t>(free.size());
  const Eigen::MatrixXd normal = reduced(free, free);
  const Eigen::LLT<Eigen::MatrixXd> cholesky(normal);
  if (cholesky.info() != Eigen::Success) {
    throw SolveError("an image, or the scale, is not determined by the points it sees");
  }
  const Eigen::MatrixXd inverse =
      cholesky.solve(Eigen::MatrixXd::Identity(normal.rows(), normal.cols()));
  const double variance = sum / static_cast<double>(std::max<std::int64_t>(1, freedom));
  std::vector<int> place(6 * images, -1);
  for (std::size_t i = 0; i < free.size(); ++i) place[free[i]] = static_cast<int>(i);
  std::vector<Matrix6> covariances(images, Matrix6::Zero());
  for (int image = 0; image < images; ++image) {
    for (int i = 0; i < 6; ++i) {
      for (int j = 0; j < 6; ++j) {
        const int row = place[6 * image + i], column = place[6 * image + j];
        if (row >= 0 && column >= 0) covariances[image](i, j) = variance * inverse(row, column);
      }
    }
  }
  return covariances;
}

}  // namespace gsut
