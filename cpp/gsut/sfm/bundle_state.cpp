// Makes the unknowns of a bundle, and images' poses from them.
#include "gsut/sfm/bundle_state.h"

#include <algorithm>
#include <numeric>

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

}  // namespace gsut
