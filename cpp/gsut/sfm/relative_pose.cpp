// RANSAC over five points, refinement on the inliers, and the choice of the decomposition.
#include "gsut/sfm/relative_pose.h"

#include <Eigen/Cholesky>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>

#include "gsut/base/check_arguments.h"
#include "gsut/sfm/minimal_solvers.h"
#include "gsut/sfm/sampler.h"
#include "gsut/sfm/triangulate.h"

namespace gsut {
namespace {

constexpr std::uint64_t kRelativePoseStream = 0x5245'4C50;  // "RELP"
constexpr int kMatches = 5;  // matches that determine an essential matrix, up to ten solutions
// Fewer inliers than this prove nothing: five points always fit.
constexpr int kFewestMatches = 8;
// Refinements of a new best pose, each on the inliers of the one before; the cost ends them
// earlier.
constexpr int kRefinements = 4;
// The first samples come from this many matches; after kGrowingSamples, from all.
constexpr int kFirstPool = 24;
constexpr int kGrowingSamples = 200;
// Steps of a refinement: from a sample's pose, quadratic convergence needs no more.
constexpr int kGaussNewtonSteps = 4;

// Sampson's error: the epipolar constraint b2^T E b1 over the length of its gradient by the four
// pixel coordinates, which is the distance to the nearest match that fulfils it, to first order.
double SquaredError(const Eigen::Matrix3d& e, const Bearing& first, const Bearing& second) {
  const Eigen::Vector3d line2 = e * first.ray;
  const Eigen::Vector3d line1 = e.transpose() * second.ray;
  const double value = second.ray.dot(line2);
  const double gradient = (line2.transpose() * second.dray_dpixel).squaredNorm() +
                          (line1.transpose() * first.dray_dpixel).squaredNorm();
  return value * value / gradient;
}

// Truncated squares: the lower the better. Stops once it exceeds `bound`.
double Cost(const Eigen::Matrix3d& e, std::span<const Bearing> first,
            std::span<const Bearing> second, double max_squared, double bound) {
  double cost = 0.0;
  for (std::size_t i = 0; i < first.size(); ++i) {
    const double squared = SquaredError(e, first[i], second[i]);
    cost += squared < max_squared ? squared : max_squared;
    if (cost > bound) return cost;
  }
  return cost;
}

// E = U diag(1, 1, 0) V^T gives R = U W V^T or U W^T V^T and t = +- u3 (Hartley and Zisserman,
// "Multiple view geometry", 2nd ed., result 9.19).
std::array<Pose, 4> Decompose(const Eigen::Matrix3d& e) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(e, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d u = svd.matrixU();
  Eigen::Matrix3d v = svd.matrixV();
  if (u.determinant() < 0) u.col(2) *= -1.0;
  if (v.determinant() < 0) v.col(2) *= -1.0;
  Eigen::Matrix3d w;
  w << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  std::array<Pose, 4> poses;
  for (int i = 0; i < 4; ++i) {
    poses[i].rotation = u * (i < 2 ? w : Eigen::Matrix3d(w.transpose())) * v.transpose();
    poses[i].translation = (i % 2 == 0 ? 1.0 : -1.0) * u.col(2);
  }
  return poses;
}

// Which of the four decompositions has most inliers in front of both cameras along their rays.
Pose ChooseInFront(const Eigen::Matrix3d& e, std::span<const Bearing> first,
                   std::span<const Bearing> second, double max_squared) {
  Pose best;
  int most = -1;
  for (const Pose& pose : Decompose(e)) {
    int count = 0;
    for (std::size_t i = 0; i < first.size(); ++i) {
      if (!(SquaredError(e, first[i], second[i]) < max_squared)) continue;
      const auto depths = RayDepths(pose, first[i].ray, second[i].ray);
      count += depths[0] > 0.0 && depths[1] > 0.0;
    }
    // Of four decompositions one puts points in front of both.
    if (count > most) {
      most = count;
      best = pose;
    }
  }
  return best;
}

// Gauss-Newton on the Sampson errors of the inliers; five unknowns: a turn of R and of t.
Pose Refine(Pose pose, std::span<const Bearing> first, std::span<const Bearing> second,
            double max_squared) {
  using Vector5 = Eigen::Matrix<double, 5, 1>;
  for (int step = 0; step < kGaussNewtonSteps; ++step) {
    const Eigen::Matrix3d e = EssentialMatrix(pose);
    const Eigen::Vector3d& t = pose.translation;
    const Eigen::Vector3d side1 = t.unitOrthogonal();
    const Eigen::Vector3d side2 = t.cross(side1);
    Eigen::Matrix<double, 5, 5> normal = Eigen::Matrix<double, 5, 5>::Zero();
    Vector5 gradient = Vector5::Zero();
    for (std::size_t i = 0; i < first.size(); ++i) {
      const Eigen::Vector3d line2 = e * first[i].ray;
      const Eigen::Vector3d line1 = e.transpose() * second[i].ray;
      const double value = second[i].ray.dot(line2);
      const double weight = 1.0 / ((line2.transpose() * second[i].dray_dpixel).squaredNorm() +
                                   (line1.transpose() * first[i].dray_dpixel).squaredNorm());
      if (!(value * value * weight < max_squared)) continue;
      // b2 . (t x a), a = R b1. A turn w of R moves a by w x a:  d = w . (a x (b2 x t)); t moves
      // across itself:  d = dt . (a x b2).
      const Eigen::Vector3d a = pose.rotation * first[i].ray;
      const Eigen::Vector3d by_rotation = a.cross(second[i].ray.cross(t));
      const Eigen::Vector3d by_translation = a.cross(second[i].ray);
      Vector5 row;
      row << by_rotation, by_translation.dot(side1), by_translation.dot(side2);
      normal += weight * row * row.transpose();
      gradient += weight * value * row;
    }
    const Vector5 change = normal.ldlt().solve(-gradient);
    if (!change.allFinite() || change.norm() > 1.0) break;
    Eigen::Matrix<double, 6, 1> turn;
    turn << 0, 0, 0, change.head<3>();
    pose.rotation = ExpPose(turn).rotation * pose.rotation;
    pose.translation = (t + change[3] * side1 + change[4] * side2).normalized();
  }
  pose.rotation = Eigen::Quaterniond(pose.rotation).normalized().toRotationMatrix();
  return pose;
}

// The rotation that carries the first rays of the chosen matches nearest to the second ones.
// (Kabsch's algorithm: U V^T of the sum of b2 b1^T, without a mirror.)
Eigen::Matrix3d FitRotation(std::span<const Bearing> first, std::span<const Bearing> second,
                            const std::vector<std::uint8_t>& chosen) {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < first.size(); ++i) {
    if (chosen[i]) sum += second[i].ray * first[i].ray.transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d sign = Eigen::Matrix3d::Identity();
  if (svd.matrixU().determinant() * svd.matrixV().determinant() < 0) sign(2, 2) = -1.0;
  return svd.matrixU() * sign * svd.matrixV().transpose();
}

// How many inliers a rotation alone explains: from the pose's, which few wrong matches move, and
// from what fits all inliers, fitted again to those that it explains.
int CountRotationInliers(std::span<const Bearing> first, std::span<const Bearing> second,
                         const std::vector<std::uint8_t>& inliers, const Eigen::Matrix3d& start,
                         double max_error) {
  int most = 0;
  for (Eigen::Matrix3d rotation : {start, FitRotation(first, second, inliers)}) {
    std::vector<std::uint8_t> chosen(inliers.size());
    for (int round = 0; round < kRefinements; ++round) {
      int count = 0;
      for (std::size_t i = 0; i < first.size(); ++i) {
        chosen[i] =
            inliers[i] && BearingResidual(second[i], rotation * first[i].ray).norm() < max_error;
        count += chosen[i];
      }
      most = std::max(most, count);
      if (count < 3) break;
      rotation = FitRotation(first, second, chosen);
    }
  }
  return most;
}

}  // namespace

Eigen::Matrix3d EssentialMatrix(const Pose& second_from_first) {
  const Eigen::Vector3d& t = second_from_first.translation;
  Eigen::Matrix3d cross;
  cross << 0, -t.z(), t.y(), t.z(), 0, -t.x(), -t.y(), t.x(), 0;
  return cross * second_from_first.rotation;
}

double EpipolarError(const Eigen::Matrix3d& essential, const Bearing& first,
                     const Bearing& second) {
  return std::sqrt(SquaredError(essential, first, second));
}

RelativePose EstimateRelativePose(std::span<const Bearing> first, std::span<const Bearing> second,
                                  const RelativePoseOptions& options) {
  CheckSameSize(first.size(), second.size(), "first and second");
  RelativePose result;
  const int count = static_cast<int>(first.size());
  result.inliers.assign(count, 0);
  if (count < kFewestMatches) return result;
  const double max_squared = options.max_error * options.max_error;
  const Rng rng(options.seed, kRelativePoseStream);
  double best_cost = max_squared * count;
  Eigen::Matrix3d best_e = Eigen::Matrix3d::Zero();
  int needed = options.max_samples;
  for (int draw = 0; draw < needed; ++draw) {
    // PROSAC's idea (Chum and Matas, 2005): matches come best first, so early samples take few of
    // them.
    const int pool = std::min(
        count,
        kFirstPool + static_cast<int>(static_cast<std::int64_t>(count) * draw / kGrowingSamples));
    const auto sample = DrawSample<kMatches>(rng, draw, pool);
    std::array<Eigen::Vector3d, kMatches> rays1, rays2;
    for (int i = 0; i < kMatches; ++i) {
      rays1[i] = first[sample[i]].ray;
      rays2[i] = second[sample[i]].ray;
    }
    bool improved = false;
    for (const Eigen::Matrix3d& e : FivePoint(rays1, rays2)) {
      const double cost = Cost(e, first, second, max_squared, best_cost);
      if (cost < best_cost) {
        best_cost = cost;
        best_e = e;
        improved = true;
      }
    }
    if (!improved) continue;
    Pose pose = ChooseInFront(best_e, first, second, max_squared);
    for (int round = 0; round < kRefinements; ++round) {
      pose = Refine(pose, first, second, max_squared);
      const Eigen::Matrix3d e = EssentialMatrix(pose);
      const double cost = Cost(e, first, second, max_squared, best_cost);
      if (!(cost < best_cost)) break;
      best_cost = cost;
      best_e = e;
    }
    int inliers = 0;
    for (int i = 0; i < count; ++i) {
      inliers += SquaredError(best_e, first[i], second[i]) < max_squared;
    }
    needed = std::min(
        needed, SamplesNeeded(static_cast<double>(inliers) / count, kMatches, options.max_samples));
  }
  // Inliers must also lie in front of both cameras, along their rays.
  if (best_e.isZero()) return result;
  const Pose pose = ChooseInFront(best_e, first, second, max_squared);
  std::vector<double> parallaxes;
  for (int i = 0; i < count; ++i) {
    if (!(SquaredError(best_e, first[i], second[i]) < max_squared)) continue;
    const auto depths = RayDepths(pose, first[i].ray, second[i].ray);
    // Parallel rays are no contradiction: their depth is only unknown.
    const double parallax = std::atan2((pose.rotation * first[i].ray).cross(second[i].ray).norm(),
                                       (pose.rotation * first[i].ray).dot(second[i].ray));
    const double blur = options.max_error * second[i].dray_dpixel.norm();
    if ((depths[0] > 0.0 && depths[1] > 0.0) || parallax < blur) {
      result.inliers[i] = 1;
      ++result.num_inliers;
      parallaxes.push_back(parallax);
    }
  }
  if (result.num_inliers < kFewestMatches) return result;
  // The upper quartile: most points may be far away, and a quarter near enough to show the motion.
  const auto upper = parallaxes.begin() + static_cast<std::ptrdiff_t>(parallaxes.size() * 3 / 4);
  std::nth_element(parallaxes.begin(), upper, parallaxes.end());
  result.parallax = *upper;
  result.num_rotation_inliers =
      CountRotationInliers(first, second, result.inliers, pose.rotation, options.max_error);
  result.second_from_first = pose;
  result.found = true;
  return result;
}

}  // namespace gsut
