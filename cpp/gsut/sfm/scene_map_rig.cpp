// Cameras of a rig in the growing structure: one pose a body, and the scale of the rig.
#include <algorithm>
#include <cmath>

#include "gsut/sfm/scene_map.h"

namespace gsut {
namespace {

// How well a rig that is adjusted is known beforehand: places by a ruler, over the rig's size, and
// turns by eye, radians. Images mostly know them a hundred times better; where they say nothing,
// the rig keeps the values of its file.
constexpr double kPlaceSigma = 0.2;
constexpr double kTurnSigma = 0.1;

// Root mean square distance of cameras from their middle, in the body's frame.
double RigSize(const std::vector<Eigen::Vector3d>& centers) {
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& center : centers) middle += center;
  middle /= static_cast<double>(std::max<std::size_t>(1, centers.size()));
  double sum = 0.0;
  for (const Eigen::Vector3d& center : centers) sum += (center - middle).squaredNorm();
  return std::sqrt(sum / static_cast<double>(std::max<std::size_t>(1, centers.size())));
}

}  // namespace

Pose SceneMap::CameraFromBody(int image) const {
  const int mount = options_.rig.mount_of_image[image];
  return mount < 0 ? Pose() : camera_from_body_[mount];
}

void SceneMap::RegisterBody(int image, const Pose& camera_from_world) {
  const Pose body_from_world = CameraFromBody(image).Inverse() * camera_from_world;
  for (int other = 0; other < num_images(); ++other) {
    if (options_.rig.body_of_image[other] != options_.rig.body_of_image[image]) continue;
    Register(other, other == image ? camera_from_world : CameraFromBody(other) * body_from_world,
             options_.KnownVelocity(other));
  }
}

// Bodies are numbered as they appear; cameras of a body without observations are added all the
// same, as their poses follow from the body's.
void SceneMap::AddRig(Bundle* bundle, BundleOptions* options, std::vector<int>* image_of) const {
  const Rig& rig = options_.rig;
  std::vector<int> place(images_.size(), -1);  // of bodies
  std::vector<std::uint8_t> sees(images_.size(), 0);
  int bodies = 0;
  for (const int image : *image_of) {
    sees[image] = 1;
    int& body = place[rig.body_of_image[image]];
    if (body < 0) body = bodies++;
  }
  for (int image = 0; image < num_images(); ++image) {
    if (!registered_[image] || sees[image] || place[rig.body_of_image[image]] < 0) continue;
    AddImage(image, bundle, image_of);
  }
  for (const int image : *image_of) {
    bundle->body_of_image.push_back(place[rig.body_of_image[image]]);
    bundle->mount_of_image.push_back(rig.mount_of_image[image]);
  }
  bundle->camera_from_body = camera_from_body_;
  options->gauge_image = image_of->empty() ? -1 : 0;
  options->scale_image = -1;
  if (!rig.refine) return;
  options->mount_free.assign(camera_from_body_.size(), 1);
  options->mount_priors = rig.camera_from_body;
  std::vector<Eigen::Vector3d> centers = {Eigen::Vector3d::Zero()};
  for (const Pose& pose : rig.camera_from_body) centers.push_back(pose.CenterInSource());
  options->mount_center_sigma = kPlaceSigma * RigSize(centers);
  options->mount_turn_sigma = kTurnSigma;
  options->noise = loss_pixels_;
  // The scale is held by a pose while mounts are free, and put right afterwards.
  double farthest = 0.0;
  for (std::size_t i = 0; i < image_of->size(); ++i) {
    if (bundle->body_of_image[i] == 0) continue;
    const double distance = (bundle->camera_from_world[i].CenterInSource() -
                             bundle->camera_from_world[0].CenterInSource())
                                .norm();
    if (distance <= farthest) continue;
    farthest = distance;
    options->scale_image = static_cast<int>(i);
  }
}

// Free mounts can grow as the world shrinks: no picture shows it. The adjustment holds the scale by
// one pose, and here everything is scaled so that the rig has its given size again.
void SceneMap::RestoreRigSize(const Bundle& bundle) {
  const Rig& rig = options_.rig;
  // Which mounts were adjusted: those of images with observations. The last entry: the body itself.
  const auto mounts = static_cast<int>(rig.camera_from_body.size());
  std::vector<std::uint8_t> used(mounts + 1, 0);
  for (const BundleObservation& observation : bundle.observations) {
    const int mount = bundle.mount_of_image[observation.image];
    used[mount < 0 ? mounts : mount] = 1;
  }
  std::vector<Eigen::Vector3d> given, found;
  for (int mount = 0; mount <= mounts; ++mount) {
    if (!used[mount]) continue;
    const Pose none;
    given.push_back((mount < mounts ? rig.camera_from_body[mount] : none).CenterInSource());
    found.push_back((mount < mounts ? camera_from_body_[mount] : none).CenterInSource());
  }
  const double size = RigSize(found);
  if (!(size > 0.0) || !(RigSize(given) > 0.0)) return;
  const double scale = RigSize(given) / size;
  for (int mount = 0; mount < mounts; ++mount) {
    if (used[mount]) camera_from_body_[mount].translation *= scale;
  }
  for (int image = 0; image < num_images(); ++image) {
    if (!registered_[image]) continue;
    Pose pose = poses_[image];
    pose.translation *= scale;
    Velocity velocity = rolling() ? velocities_[image] : Velocity::Zero();
    velocity.head<3>() *= scale;
    Place(image, pose, velocity);
  }
  for (Track& track : tracks_) track.position *= scale;
}

}  // namespace gsut
