// Covariances, shadows and the way back to quaternion and log-scales.
#include "gsut/optimize/moments.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "gsut/gaussians/activations.h"

namespace gsut {
namespace {

// Knud Thomsen's formula (2004) for the surface of an ellipsoid: off by 1.06 % at most.
constexpr double kThomsenPower = 1.6075;
// Of a merged Gaussian, smallest variance over the largest: 1e-6 as standard deviations, which
// float parameters still distinguish from a plane.
constexpr double kLeastVarianceRatio = 1e-12;
// Variances are kept above what float's log-scales and their exponentials can hold.
constexpr double kTiniestVariance = 1e-60;

}  // namespace

Eigen::Matrix3d CovarianceOf(const GaussiansView<const float>& gaussians, std::int64_t row) {
  double quat[4], rotation[9];
  for (int i = 0; i < 4; ++i) quat[i] = gaussians.quats[4 * row + i];
  RotationFromQuaternion(quat, rotation);
  Eigen::Matrix3d scaled;
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      const auto log_scale = static_cast<double>(gaussians.log_scales[3 * row + k]);
      scaled(i, k) = rotation[3 * i + k] * ScaleFromLog(log_scale);
    }
  }
  return scaled * scaled.transpose();
}

Moments MergeMoments(const Moments& a, const Moments& b) {
  // Mean and covariance of a mixture of two: variances, and the variance of the means.
  const double weight = a.weight + b.weight;
  const double share = weight > 0.0 ? b.weight / weight : 0.5;
  const Eigen::Vector3d between = b.mean - a.mean;
  Moments out;
  out.weight = weight;
  out.mean = a.mean + share * between;
  out.covariance = (1.0 - share) * a.covariance + share * b.covariance +
                   share * (1.0 - share) * between * between.transpose();
  return out;
}

// By Cauchy's theorem the mean area of a convex body's shadow is a quarter of its surface.
double ShadowArea(double a, double b, double c) {
  const double sum = std::pow(a * b, kThomsenPower) + std::pow(a * c, kThomsenPower) +
                     std::pow(b * c, kThomsenPower);
  return std::pow(sum / 3.0, 1.0 / kThomsenPower);
}

double ShadowArea(const Eigen::Matrix3d& covariance) {
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  solver.computeDirect(covariance, Eigen::EigenvaluesOnly);
  const Eigen::Vector3d s = solver.eigenvalues().cwiseMax(0.0).cwiseSqrt();
  return ShadowArea(s[0], s[1], s[2]);
}

void ParametersOf(const Eigen::Matrix3d& covariance, double least, float* quat, float* log_scales) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
  const double floor =
      std::max({least, kLeastVarianceRatio * solver.eigenvalues()[2], kTiniestVariance});
  // Eigenvectors may be a mirrored frame, which no quaternion is.
  Eigen::Matrix3d axes = solver.eigenvectors();
  if (axes.determinant() < 0.0) axes.col(0) = -axes.col(0);
  const Eigen::Quaterniond rotation(axes);
  const double sign = rotation.w() < 0.0 ? -1.0 : 1.0;
  quat[0] = static_cast<float>(sign * rotation.w());
  quat[1] = static_cast<float>(sign * rotation.x());
  quat[2] = static_cast<float>(sign * rotation.y());
  quat[3] = static_cast<float>(sign * rotation.z());
  for (int k = 0; k < 3; ++k) {
    log_scales[k] = static_cast<float>(0.5 * std::log(std::max(solver.eigenvalues()[k], floor)));
  }
}

}  // namespace gsut
