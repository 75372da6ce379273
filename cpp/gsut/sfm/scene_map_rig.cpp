// Cameras of a rig in the growing structure: one pose a body, and the scale of the rig. A body is
// placed by P3P of each of its images, then one pose for the observations of all of them.
#include <algorithm>
#include <cmath>

#include "gsut/sfm/absolute_pose.h"
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

namespace {

// Points that one image must see for a pose to begin with: three make it, the others vote.
constexpr int kFewestOfOne = 8;
// A pose of few points may put those of the other images this many times the largest error off.
constexpr double kRigLooser = 4.0;
// Rounds of choosing observations and adjusting: the choice settles in two.
constexpr int kRounds = 3;
// Iterations of a round: six unknowns converge in a few.
constexpr int kRigIterations = 20;

struct Placement {
  Pose camera_from_world;  // of the first of the images
  int agreeing = 0;        // observations of all images
};

double Error(const Bearing& bearing, const Pose& pose, const Eigen::Vector3d& point) {
  return BearingResidual(bearing, pose.rotation * point + pose.translation).norm();
}

// On a rig one pose places all cameras. P3P on one image gives a start; bundle adjustment with
// fixed points, fixed mounts and one free body then uses what all of them see. The body's pose from
// that of its image `from`, by what all its images see.
Placement PlaceBody(const std::vector<int>& images, const std::vector<SceneMap::Visible>& visible,
                    std::size_t from, const Pose& camera_from_world, double max_error,
                    const SceneMap& map) {
  Bundle bundle;
  bundle.cameras = {map.cameras()[0]};  // not asked: the residual is that of the bearings
  bundle.camera_of_image.assign(images.size(), 0);
  bundle.body_of_image.assign(images.size(), 0);
  const Pose body_from_world = map.CameraFromBody(images[from]).Inverse() * camera_from_world;
  for (std::size_t i = 0; i < images.size(); ++i) {
    bundle.mount_of_image.push_back(static_cast<int>(i));
    bundle.camera_from_body.push_back(map.CameraFromBody(images[i]));
    bundle.camera_from_world.push_back(bundle.camera_from_body[i] * body_from_world);
  }
  // The first round takes observations that the start, from one image alone, may put far off.
  double error = kRigLooser * max_error;
  for (int round = 0; round < kRounds; ++round) {
    bundle.observations.clear();
    bundle.points.clear();
    for (std::size_t i = 0; i < images.size(); ++i) {
      for (std::size_t k = 0; k < visible[i].points.size(); ++k) {
        const Eigen::Vector3d& point = visible[i].points[k];
        const Bearing& bearing = visible[i].bearings[k];
        if (!(Error(bearing, bundle.camera_from_world[i], point) < error)) continue;
        bundle.observations.push_back(
            {static_cast<int>(i), static_cast<int>(bundle.points.size()), bearing});
        bundle.points.push_back(point);
      }
    }
    if (static_cast<int>(bundle.points.size()) < kFewestOfOne) return {};
    BundleOptions options;
    options.point_fixed.assign(bundle.points.size(), 1);
    options.loss_scale = max_error / kRigLooser;
    options.max_iterations = kRigIterations;
    AdjustBundle(&bundle, options);
    error = max_error;
  }
  Placement placement = {bundle.camera_from_world[0], 0};
  for (std::size_t i = 0; i < images.size(); ++i) {
    for (std::size_t k = 0; k < visible[i].points.size(); ++k) {
      placement.agreeing += Error(visible[i].bearings[k], bundle.camera_from_world[i],
                                  visible[i].points[k]) < max_error;
    }
  }
  return placement;
}

}  // namespace

int PlaceBodies(const StructureOptions& options, SceneMap* map) {
  std::vector<std::vector<int>> bodies(map->num_images());
  for (int image = 0; image < map->num_images(); ++image) {
    if (!map->registered(image)) bodies[options.rig.body_of_image[image]].push_back(image);
  }
  const int before = map->num_registered();
  // Bodies are placed from the same structure and registered together: their order does not matter.
  std::vector<std::pair<int, Pose>> found;  // first image of the body, its pose
  for (const std::vector<int>& images : bodies) {
    std::vector<SceneMap::Visible> visible;
    std::size_t seen = 0;
    for (const int image : images) {
      visible.push_back(map->VisiblePoints(image));
      seen += visible.back().points.size();
    }
    if (static_cast<int>(seen) < options.min_inliers) continue;
    // Each image of the body may give the start; the one most observations agree with wins.
    Placement best;
    for (std::size_t i = 0; i < images.size(); ++i) {
      AbsolutePoseOptions settings;
      settings.max_error = options.max_error;
      settings.seed = options.seed + static_cast<std::uint64_t>(images[i]);
      const AbsolutePose pose =
          EstimateAbsolutePose(visible[i].bearings, visible[i].points, settings);
      if (pose.num_inliers < kFewestOfOne) continue;
      const Placement placement =
          PlaceBody(images, visible, i, pose.camera_from_world, options.max_error, *map);
      if (placement.agreeing > best.agreeing) best = placement;
    }
    if (best.agreeing < options.min_inliers ||
        best.agreeing < kFewestInlierShare * static_cast<double>(seen)) {
      continue;
    }
    found.emplace_back(images[0], best.camera_from_world);
  }
  for (const auto& [image, pose] : found) map->RegisterBody(image, pose);
  return map->num_registered() - before;
}

}  // namespace gsut
