// The residual of an observation of a bundle, with its derivatives.
#pragma once

#include <Eigen/Core>

#include "gsut/geometry/camera_chain.h"
#include "gsut/sfm/bundle.h"
#include "gsut/sfm/bundle_state.h"
#include "gsut/sfm/lens_evaluation.h"

namespace gsut {

struct ObservationResidual {
  Eigen::Vector2d residual;
  ChainDerivatives by;
  const double* by_params =
      nullptr;  // (2, K) row-major, by a free lens; null: does not depend on it
};

// Through the lens, or without one (lenses null) the residual of Bearing, which also stands in
// where the point is outside the lens' domain. lenses: evaluated at the state. False: there is
// none.
bool EvaluateObservation(const Bundle& bundle, const BundleState& state, int index,
                         const LensEvaluation* lenses, ObservationResidual* out);

}  // namespace gsut
