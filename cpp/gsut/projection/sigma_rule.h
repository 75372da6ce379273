// Sets of points that stand for a Gaussian: sums over them replace its integrals.
#pragma once

#include "gsut/projection/footprint.h"

namespace gsut {

// Points in whitened coordinates (standard normal), with the weights of mean and covariance.
// Covariances are taken about the weighted mean.
struct SigmaRule {
  static constexpr int kMaxPoints = 27;
  int size = 0;
  double points[kMaxPoints][3] = {};
  double mean_weights[kMaxPoints] = {};
  double cov_weights[kMaxPoints] = {};
};

// The rule of a method that has one; throws InputError for options without sigma points.
SigmaRule MakeSigmaRule(ProjectionMethod method, const UnscentedOptions& options);

}  // namespace gsut
