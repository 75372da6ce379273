// The residuals of bundle adjustment, with derivatives written out.
#pragma once

#include <ceres/cost_function.h>

#include "gsut/sfm/bundle.h"
#include "gsut/sfm/bundle_state.h"
#include "gsut/sfm/lens_evaluation.h"

namespace gsut {

// One observation: through the lens, or without one (lenses null) the residual of Bearing. Where
// the point is outside the lens' domain the residual of Bearing stands in.
class ReprojectionCost : public ceres::CostFunction {
 public:
  // All are kept by reference; index: of the observation in the bundle.
  ReprojectionCost(const Bundle& bundle, const BundleState& state, int index,
                   const LensEvaluation* lenses, bool lens_free);

  // The parameter blocks it takes, in order: the body's pose, the point and, where there are such,
  // the body's velocity, the mount and the free lens.
  std::vector<double*> Blocks(BundleState* state) const;

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override;

 private:
  const BundleObservation& observation_;
  int body_, mount_, camera_;
  int index_;
  const LensEvaluation* lenses_;
  int num_lens_ = 0;
  int velocity_place_ = -1, mount_place_ = -1, lens_place_ = -1;
};

// (velocity - mean) noise / sigma; no residual where sigma is infinite.
class VelocityCost : public ceres::CostFunction {
 public:
  VelocityCost(const VelocityPrior& prior, double noise);
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override;

 private:
  Velocity mean_, weight_;
};

}  // namespace gsut
