// The unknowns of a bundle as the solver's parameter blocks, and its residuals at them.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "gsut/geometry/camera_chain.h"
#include "gsut/geometry/pose_block.h"
#include "gsut/sfm/bundle.h"

namespace gsut {

class LensEvaluation;

// The component of the second pose's centre that is farthest from the first's: held, it sets the
// scale.
int ScaleAxis(const PoseBlock& first, const PoseBlock& second);

struct BundleState {
  explicit BundleState(const Bundle& bundle);

  int num_bodies() const { return static_cast<int>(poses.size()); }
  CameraChain Chain(const BundleObservation& observation) const;
  // camera_from_world of an image in the middle of its readout.
  Pose CameraFromWorld(int image) const;

  std::vector<PoseBlock> poses;      // of bodies
  std::vector<Velocity> velocities;  // of bodies; empty: none move
  std::vector<PoseBlock> mounts;
  std::vector<Eigen::Vector3d> points;
  std::vector<std::vector<double>> lenses;
  Eigen::VectorXd calibration;                     // of the gyroscope, from that of the priors
  std::vector<int> body_of_image, mount_of_image;  // one an image; mount -1: none
  std::vector<int> image_of_body;                  // the first
};

struct ObservationResidual {
  Eigen::Vector2d residual;
  ChainDerivatives by;
  const double* by_params = nullptr;  // (2, F) row-major, by the free parameters of its lens; null:
                                      // does not depend on them
};

// Through the lens, or without one (lenses null) the residual of Bearing, which also stands in
// where the point is outside the lens' domain. lenses: evaluated at the state. False: there is
// none.
bool EvaluateObservation(const Bundle& bundle, const BundleState& state, int index,
                         const LensEvaluation* lenses, ObservationResidual* out);

}  // namespace gsut
