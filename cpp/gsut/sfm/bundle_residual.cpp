// Residuals of observations and their derivatives.
#include "gsut/sfm/bundle_residual.h"

namespace gsut {

bool EvaluateObservation(const Bundle& bundle, const BundleState& state, int index,
                         const LensEvaluation* lenses, ObservationResidual* out) {
  const BundleObservation& observation = bundle.observations[index];
  LensEvaluation::Row row = {};
  if (lenses != nullptr) row = lenses->Get(index);
  if (row.lens_failed) return false;
  const CameraChain chain = state.Chain(observation);
  const Eigen::Vector3d& point = state.points[observation.point];
  Eigen::Matrix<double, 2, 3> by_p;
  // Through the lens where it sees the point; elsewhere by the bearing, which is defined everywhere
  // and grows the farther off the point is, so that leaving the image never pays.
  if (row.valid) {
    out->residual = Eigen::Map<const Eigen::Vector2d>(row.pixel) - observation.pixel;
    by_p = Eigen::Map<const Eigen::Matrix<double, 2, 3, Eigen::RowMajor>>(row.dpixel_dpoint);
    out->by_params = row.dpixel_dparams;
  } else {
    out->residual = BearingResidual(observation.bearing, chain.Point(point), &by_p);
    out->by_params = nullptr;
  }
  // A point at the camera's centre has no direction: the whole step is refused.
  if (!out->residual.allFinite()) return false;
  // The chain rule to the body's pose, its velocity, its mount and the point.
  out->by = Derivatives(chain, point, by_p);
  return true;
}

}  // namespace gsut
