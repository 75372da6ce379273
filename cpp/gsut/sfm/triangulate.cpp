// Points of rays: pairs as hypotheses, then least squares in pixels.
#include "gsut/sfm/triangulate.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace gsut {
namespace {

// Pairs of rays tried, of those with the widest angles: one good pair is enough.
constexpr int kMostPairs = 30;
// From a midpoint Gauss-Newton converges in three or four steps.
constexpr int kGaussNewtonSteps = 10;

struct Pair {
  int first, second;
  double angle;
};

Eigen::Vector3d RayInWorld(const PosedBearing& observation) {
  return observation.camera_from_world->rotation.transpose() * observation.bearing->ray;
}

// The midpoint between two rays in the world; false if it lies behind one of them.
bool Midpoint(const PosedBearing& first, const PosedBearing& second, Eigen::Vector3d* point) {
  const Eigen::Vector3d center1 = first.camera_from_world->CenterInSource();
  const Eigen::Vector3d center2 = second.camera_from_world->CenterInSource();
  const Eigen::Vector3d ray1 = RayInWorld(first);
  const Eigen::Vector3d ray2 = RayInWorld(second);
  Pose aligned;  // the first camera's axes turned into the world's
  aligned.translation = center1 - center2;
  const auto depths = RayDepths(aligned, ray1, ray2);
  if (!(depths[0] > 0.0 && depths[1] > 0.0)) return false;
  *point = 0.5 * (center1 + depths[0] * ray1 + center2 + depths[1] * ray2);
  return point->allFinite();
}

double SquaredResidual(const PosedBearing& observation, const Eigen::Vector3d& point) {
  const Pose& pose = *observation.camera_from_world;
  return BearingResidual(*observation.bearing, pose.rotation * point + pose.translation)
      .squaredNorm();
}

}  // namespace

std::array<double, 2> RayDepths(const Pose& second_from_first, const Eigen::Vector3d& ray1,
                                const Eigen::Vector3d& ray2) {
  // t + depth1 a = depth2 ray2 in the second camera, in the least-squares sense: the vector between
  // the nearest points is along n = a x ray2. Crossing the equation with ray2 or a, and taking the
  // part along n, leaves one depth each.
  const Eigen::Vector3d a = second_from_first.rotation * ray1;
  const Eigen::Vector3d& t = second_from_first.translation;
  const Eigen::Vector3d normal = a.cross(ray2);
  const double squared_sine = normal.squaredNorm();
  return {ray2.cross(t).dot(normal) / squared_sine, a.cross(t).dot(normal) / squared_sine};
}

// The largest angle between two rays at the point is what its depth can be known from. Rays far
// apart in the list are compared first: in a walk they mostly differ enough, and one such pair
// suffices.
bool ReachesAngle(std::span<const PosedBearing> observations, std::span<const std::uint8_t> chosen,
                  const Eigen::Vector3d& point, double min_angle) {
  std::vector<Eigen::Vector3d> rays;
  for (std::size_t i = 0; i < observations.size(); ++i) {
    if (chosen[i]) rays.push_back(point - observations[i].camera_from_world->CenterInSource());
  }
  for (std::size_t gap = rays.size(); gap-- > 1;) {
    for (std::size_t i = 0; i + gap < rays.size(); ++i) {
      const Eigen::Vector3d &a = rays[i], &b = rays[i + gap];
      if (std::atan2(a.cross(b).norm(), a.dot(b)) >= min_angle) return true;
    }
  }
  return min_angle <= 0.0;
}

bool RefinePoint(std::span<const PosedBearing> observations, std::span<const std::uint8_t> chosen,
                 Eigen::Vector3d* point) {
  for (int step = 0; step < kGaussNewtonSteps; ++step) {
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    double distance = 0.0;
    for (std::size_t i = 0; i < observations.size(); ++i) {
      if (!chosen[i]) continue;
      const Pose& pose = *observations[i].camera_from_world;
      const Eigen::Vector3d in_camera = pose.rotation * *point + pose.translation;
      Eigen::Matrix<double, 2, 3> by_point;
      const Eigen::Vector2d residual =
          BearingResidual(*observations[i].bearing, in_camera, &by_point);
      const Eigen::Matrix<double, 2, 3> jacobian = by_point * pose.rotation;
      normal += jacobian.transpose() * jacobian;
      gradient += jacobian.transpose() * residual;
      distance = std::max(distance, in_camera.norm());
    }
    // A step farther than the point's distance has left the region where the residual is nearly
    // linear.
    const Eigen::Vector3d change = normal.ldlt().solve(-gradient);
    if (!change.allFinite() || change.norm() > distance) return false;
    *point += change;
    constexpr double kConverged = 1e-9;
    if (change.norm() < kConverged * distance) break;
  }
  return point->allFinite();
}

TriangulatedPoint Triangulate(std::span<const PosedBearing> observations,
                              const TriangulationOptions& options) {
  TriangulatedPoint best;
  const int count = static_cast<int>(observations.size());
  best.kept.assign(count, 0);
  std::vector<Pair> pairs;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d a = RayInWorld(observations[i]);
    for (int j = i + 1; j < count; ++j) {
      const Eigen::Vector3d b = RayInWorld(observations[j]);
      const double angle = std::atan2(a.cross(b).norm(), a.dot(b));
      if (angle >= options.min_angle) pairs.push_back({i, j, angle});
    }
  }
  // Wide pairs place a point best.
  const auto wider = [](const Pair& a, const Pair& b) { return a.angle > b.angle; };
  if (pairs.size() > kMostPairs) {
    std::nth_element(pairs.begin(), pairs.begin() + kMostPairs, pairs.end(), wider);
    pairs.resize(kMostPairs);
  }
  const double max_squared = options.max_error * options.max_error;
  double best_cost = max_squared * count;
  std::vector<std::uint8_t> kept(count);
  // Truncated squares, as of RANSAC: every hypothesis is judged by all observations.
  const auto judge = [&](const Eigen::Vector3d& point) {
    double cost = 0.0;
    int inliers = 0;
    for (int i = 0; i < count; ++i) {
      const double squared = SquaredResidual(observations[i], point);
      kept[i] = squared < max_squared;
      inliers += kept[i];
      cost += kept[i] ? squared : max_squared;
    }
    if (inliers < 2 || !(cost < best_cost)) return;
    best_cost = cost;
    best.point = point;
    best.kept = kept;
    best.num_kept = inliers;
  };
  for (const Pair& pair : pairs) {
    Eigen::Vector3d point;
    if (Midpoint(observations[pair.first], observations[pair.second], &point)) judge(point);
    if (best.num_kept == count) break;
  }
  if (best.num_kept == 0) return best;
  Eigen::Vector3d refined = best.point;
  if (RefinePoint(observations, best.kept, &refined)) judge(refined);
  if (!ReachesAngle(observations, best.kept, best.point, options.min_angle)) {
    best.num_kept = 0;
    best.kept.assign(count, 0);
  }
  return best;
}

}  // namespace gsut
