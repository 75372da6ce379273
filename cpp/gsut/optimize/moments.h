// Second moments of Gaussians: covariance from parameters and back, apparent size, merging of two.
#pragma once

#include <Eigen/Core>

#include "gsut/gaussians/gaussians.h"

namespace gsut {

// Mean and covariance with a weight, in double; means are relative to an origin of the caller's.
struct Moments {
  double weight = 0.0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
};

// Covariance R diag(exp(2 log_scale)) R^T of one row.
Eigen::Matrix3d CovarianceOf(const GaussiansView<const float>& gaussians, std::int64_t row);

// Weighted mean and covariance of two, the term between their means included: the mixture's first
// two moments exactly. Without any weight the two count the same.
Moments MergeMoments(const Moments& a, const Moments& b);

// Mean over all directions of the area of the ellipsoid's shadow at one standard deviation, from
// the three standard deviations; 1 for the unit sphere, which has the area pi. By Cauchy's theorem
// it is a quarter of the surface, for which Thomsen's formula (2004) errs by at most 1.061 %.
double ShadowArea(double a, double b, double c);
double ShadowArea(const Eigen::Matrix3d& covariance);

// Writes quaternion (w, x, y, z, unit, w >= 0) and log-scales of a covariance. Variances below
// `least` and below 1e-12 of the largest are raised to that.
void ParametersOf(const Eigen::Matrix3d& covariance, double least, float* quat, float* log_scales);

}  // namespace gsut
