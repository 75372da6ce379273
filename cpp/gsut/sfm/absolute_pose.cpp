// RANSAC over three points and refinement on the inliers.
#include "gsut/sfm/absolute_pose.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>

#include "gsut/base/check_arguments.h"
#include "gsut/sfm/sampler.h"
#include "gsut/sfm/minimal_solvers.h"

namespace gsut {
namespace {

constexpr std::uint64_t kAbsolutePoseStream = 0x4142'5350;  // "ABSP"
constexpr int kPoints = 3;  // points that determine a pose, but for four solutions
// From a pose of three points, errors of the inliers stop falling after two or three steps.
constexpr int kGaussNewtonSteps = 5;
// A refined pose has more inliers, which refine it again; the cost decides when to stop.
constexpr int kRefinements = 3;

// Sum of squared errors, each at most max_squared (MSAC: Torr and Zisserman, "MLESAC", 2000), which
// ranks poses of equally many inliers too. Stops once it exceeds `bound`.

double Cost(const Pose& pose, std::span<const Bearing> bearings,
            std::span<const Eigen::Vector3d> points, double max_squared, double bound) {
  double cost = 0.0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const double squared =
        BearingResidual(bearings[i], pose.rotation * points[i] + pose.translation).squaredNorm();
    cost += squared < max_squared ? squared : max_squared;
    if (cost > bound) break;
  }
  return cost;
}

}  // namespace

Pose RefineAbsolutePose(const Pose& camera_from_world, std::span<const Bearing> bearings,
                        std::span<const Eigen::Vector3d> points, double max_error) {
  CheckSameSize(bearings.size(), points.size(), "bearings and points");
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  Pose pose = camera_from_world;
  for (int step = 0; step < kGaussNewtonSteps; ++step) {
    Eigen::Matrix<double, 6, 6> normal = Eigen::Matrix<double, 6, 6>::Zero();
    Vector6 gradient = Vector6::Zero();
    for (std::size_t i = 0; i < points.size(); ++i) {
      const Eigen::Vector3d p = pose.rotation * points[i] + pose.translation;
      Eigen::Matrix<double, 2, 3> by_point;
      const Eigen::Vector2d residual = BearingResidual(bearings[i], p, &by_point);
      if (!(residual.squaredNorm() < max_error * max_error)) continue;
      // pose <- exp(v, w) pose moves the point by v + w x p, so the derivatives by w are those of
      // the cross product, - by_point [p]x, column by column.
      Eigen::Matrix<double, 2, 6> jacobian;  // of a twist from the left
      jacobian.leftCols<3>() = by_point;
      jacobian.col(3) = by_point * Eigen::Vector3d(0, -p.z(), p.y());
      jacobian.col(4) = by_point * Eigen::Vector3d(p.z(), 0, -p.x());
      jacobian.col(5) = by_point * Eigen::Vector3d(-p.y(), p.x(), 0);
      normal += jacobian.transpose() * jacobian;
      gradient += jacobian.transpose() * residual;
    }
    const Vector6 change = normal.ldlt().solve(-gradient);
    if (!change.allFinite()) break;
    pose = ExpPose(change) * pose;
  }
  pose.rotation = Eigen::Quaterniond(pose.rotation).normalized().toRotationMatrix();
  return pose;
}

AbsolutePose EstimateAbsolutePose(std::span<const Bearing> bearings,
                                  std::span<const Eigen::Vector3d> points,
                                  const AbsolutePoseOptions& options) {
  CheckSameSize(bearings.size(), points.size(), "bearings and points");
  AbsolutePose result;
  const int count = static_cast<int>(points.size());
  result.inliers.assign(count, 0);
  if (count < kPoints + 1) return result;
  const double max_squared = options.max_error * options.max_error;
  const Rng rng(options.seed, kAbsolutePoseStream);
  const auto inliers_of = [&](const Pose& pose) {
    int inliers = 0;
    for (int i = 0; i < count; ++i) {
      result.inliers[i] =
          BearingResidual(bearings[i], pose.rotation * points[i] + pose.translation).squaredNorm() <
          max_squared;
      inliers += result.inliers[i];
    }
    return inliers;
  };
  // LO-RANSAC (Chum, Matas, Kittler, 2003): each new best sample is refined on its inliers, which
  // makes the inlier share higher and the number of samples needed lower.
  double best_cost = max_squared * count;
  bool found = false;
  int needed = options.max_samples;
  for (int draw = 0; draw < needed; ++draw) {
    const auto sample = DrawSample<kPoints>(rng, draw, count);
    std::array<Eigen::Vector3d, kPoints> rays, seen;
    for (int i = 0; i < kPoints; ++i) {
      rays[i] = bearings[sample[i]].ray;
      seen[i] = points[sample[i]];
    }
    // Up to four poses fit three points; the cost over all points decides between them.
    bool improved = false;
    for (const Pose& pose : ThreePoint(rays, seen)) {
      const double cost = Cost(pose, bearings, points, max_squared, best_cost);
      if (cost < best_cost) {
        best_cost = cost;
        result.camera_from_world = pose;
        improved = found = true;
      }
    }
    if (!improved) continue;
    for (int round = 0; round < kRefinements; ++round) {
      const Pose pose =
          RefineAbsolutePose(result.camera_from_world, bearings, points, options.max_error);
      const double cost = Cost(pose, bearings, points, max_squared, best_cost);
      if (!(cost < best_cost)) break;
      best_cost = cost;
      result.camera_from_world = pose;
    }
    // The more inliers, the fewer samples until one of them held inliers only.
    const double share = static_cast<double>(inliers_of(result.camera_from_world)) / count;
    needed = std::min(needed, SamplesNeeded(share, kPoints, options.max_samples));
  }
  if (found) result.num_inliers = inliers_of(result.camera_from_world);
  return result;
}

}  // namespace gsut
