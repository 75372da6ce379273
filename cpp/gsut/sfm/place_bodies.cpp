// P3P by each image of a body, then one pose of the body to the observations of all of them.
#include "gsut/sfm/place_bodies.h"

#include <algorithm>

#include "gsut/sfm/absolute_pose.h"

namespace gsut {
namespace {

// Points that one image must see for a pose to begin with: three make it, the others vote.
constexpr int kFewestOfOne = 8;
// A pose of few points may put those of the other images this many times the largest error off.
constexpr double kLooser = 4.0;
// Rounds of choosing observations and adjusting: the choice settles in two.
constexpr int kRounds = 3;
// Iterations of a round: six unknowns converge in a few.
constexpr int kIterations = 20;

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
  double error = kLooser * max_error;
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
    options.loss_scale = max_error / kLooser;
    options.max_iterations = kIterations;
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
