// Makes the unknowns of a bundle, images' poses from them, and residuals with their derivatives.
#include "gsut/sfm/bundle_state.h"

#include <algorithm>
#include <numeric>

#include "gsut/sfm/lens_evaluation.h"

namespace gsut {

// The component in which two centres differ most: holding it holds their distance best.
int ScaleAxis(const PoseBlock& first, const PoseBlock& second) {
  int axis = 0;
  (CenterOf(second.data()) - CenterOf(first.data())).cwiseAbs().maxCoeff(&axis);
  return axis;
}

BundleState::BundleState(const Bundle& bundle)
    : points(bundle.points),
      body_of_image(bundle.body_of_image),
      mount_of_image(bundle.mount_of_image) {
  const std::size_t images = bundle.camera_from_world.size();
  // Without a rig every image is a body of its own.
  if (body_of_image.empty()) {
    body_of_image.resize(images);
    std::iota(body_of_image.begin(), body_of_image.end(), 0);
  }
  mount_of_image.resize(images, -1);
  for (const Pose& mount : bundle.camera_from_body) mounts.push_back(ToBlock(mount));
  for (const Camera& camera : bundle.cameras) lenses.push_back(camera.params());
  const int bodies = images == 0 ? 0 : 1 + *std::ranges::max_element(body_of_image);
  poses.resize(bodies);
  image_of_body.assign(bodies, -1);
  if (!bundle.velocities.empty()) velocities.assign(bodies, Velocity::Zero());
  // A body's pose is that of its first image, carried back over the mount.
  for (std::size_t image = 0; image < images; ++image) {
    const int body = body_of_image[image];
    if (image_of_body[body] >= 0) continue;
    image_of_body[body] = static_cast<int>(image);
    const Pose& pose = bundle.camera_from_world[image];
    const int mount = mount_of_image[image];
    poses[body] = ToBlock(mount < 0 ? pose : bundle.camera_from_body[mount].Inverse() * pose);
    if (!velocities.empty()) velocities[body] = bundle.velocities[image];
  }
}

CameraChain BundleState::Chain(const BundleObservation& observation) const {
  const int body = body_of_image[observation.image];
  const int mount = mount_of_image[observation.image];
  return {poses[body].data(), velocities.empty() ? nullptr : velocities[body].data(),
          mount < 0 ? nullptr : mounts[mount].data(), observation.time};
}

// An image's own pose is that in the middle of its readout, time 0.
Pose BundleState::CameraFromWorld(int image) const {
  BundleObservation middle;
  middle.image = image;
  return Chain(middle).CameraFromWorld();
}

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
