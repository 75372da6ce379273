// Triangulates along roughly right poses and adjusts poses, points and lenses in tightening rounds.
#include "gsut/sfm/refine_structure.h"

#include <algorithm>
#include <string>
#include <utility>

#include "gsut/base/errors.h"
#include "gsut/sfm/scene_map.h"

namespace gsut {
namespace {

// Largest errors of the first rounds, in units of the final one: a lens that is 2 % off moves
// observations at its rim by several pixels.
constexpr double kLooser[] = {8.0, 4.0, 2.0};
// Rounds of adjusting and choosing observations again at the final error; most settle in two.
constexpr int kFinalRounds = 4;
// Iterations of a round, which the tolerance nearly always ends first.
constexpr int kIterations = 30;
// Relative decrease of the cost at which a round stops: the next one changes the observations
// anyway.
constexpr double kTolerance = 1e-4;
// Iterations of the last adjustment, whose minimum is the result.
constexpr int kLastIterations = 50;
// Its tolerance: covariances are those of a minimum.
constexpr double kLastTolerance = 1e-8;
// The same of trials, which are compared by held-out observations, and of rolling shutters, whose
// motion and velocity hardly differ in what they do to a picture: steps along that valley cost much
// and change nothing that is seen.
constexpr double kRoughLastTolerance = 1e-6;
constexpr int kRollingRounds = 2;
// Below this share of new and dropped observations the rounds end.
constexpr double kSettled = 5e-4;
// Points below which the given poses do not fit their photographs.
constexpr int kFewestPoints = 30;

// Every image on a body and a mount that are there, and all images of a body with a pose or none.
void CheckRig(const Rig& rig, const std::vector<std::uint8_t>& registered, std::size_t images) {
  const bool all = std::count(registered.begin(), registered.end(), 0) == 0;
  if (!registered.empty() && registered.size() != images) {
    throw InputError("registered must be empty or have one flag an image");
  }
  if (rig.body_of_image.empty()) {
    if (all) return;
    throw InputError("images without a pose can be placed on a rig only");
  }
  if (rig.body_of_image.size() != images || rig.mount_of_image.size() != images) {
    throw InputError("a rig must have one body and one mount an image");
  }
  std::vector<int> known(images, -1);
  for (std::size_t image = 0; image < images; ++image) {
    const int body = rig.body_of_image[image], mount = rig.mount_of_image[image];
    if (body < 0 || body >= static_cast<int>(images) || mount < -1 ||
        mount >= static_cast<int>(rig.camera_from_body.size())) {
      throw InputError("an image of the rig names body " + std::to_string(body) + " and mount " +
                       std::to_string(mount) + ", which are not there");
    }
    const int flag = all ? 1 : static_cast<int>(registered[image] != 0);
    if (known[body] >= 0 && known[body] != flag) {
      throw InputError("some images of a body have a pose and others have none");
    }
    known[body] = flag;
  }
}

void CheckPoses(const std::vector<ImageFeatures>& images, const std::vector<Pose>& poses) {
  if (images.size() < 2 || poses.size() != images.size()) {
    throw InputError("poses of at least two images are needed, found " +
                     std::to_string(poses.size()) + " poses of " + std::to_string(images.size()) +
                     " images");
  }
}

void ReportProgress(const SceneMap& map, const char* step,
                    const std::function<bool(const StructureProgress&)>& on_progress) {
  if (!on_progress) return;
  const StructureProgress progress = {map.num_registered(), map.num_images(), map.num_points(),
                                      step};
  if (!on_progress(progress)) throw SolveError("stopped");
}

// Holds the gauge by the first image that is there, and the scale by the one farthest from it: the
// longest baseline holds it best.
std::pair<int, int> HoldGauge(SceneMap* map) {
  int first = -1, farthest = -1;
  double longest = -1.0;
  for (int image = 0; image < map->num_images(); ++image) {
    if (!map->registered(image)) continue;
    if (first < 0) {
      first = image;
      continue;
    }
    const double distance =
        (map->pose(image).CenterInSource() - map->pose(first).CenterInSource()).squaredNorm();
    if (distance <= longest) continue;
    longest = distance;
    farthest = image;
  }
  map->SetGauge(first, farthest);
  return {first, farthest};
}

}  // namespace

Structure RefineStructure(const std::vector<Camera>& cameras,
                          const std::vector<ImageFeatures>& images,
                          std::span<const VerifiedPair> pairs,
                          const std::vector<Pose>& camera_from_world,
                          const std::vector<std::uint8_t>& registered,
                          const StructureOptions& options,
                          const std::function<bool(const StructureProgress&)>& on_progress) {
  CheckStructure(cameras, images, options);
  CheckPoses(images, camera_from_world);
  CheckRig(options.rig, registered, images.size());
  // Rounds of: complete tracks, adjust, drop what is off; from loose to tight.
  StructureOptions current = options;  // the map reads its largest error in every round
  SceneMap map(cameras, images, pairs, current);
  for (int image = 0; image < map.num_images(); ++image) {
    if (!registered.empty() && !registered[image]) continue;
    map.Register(image, camera_from_world[image], options.KnownVelocity(image));
  }
  const auto [first, farthest] = HoldGauge(&map);
  const auto report = [&](const char* step) { ReportProgress(map, step, on_progress); };
  const bool lens_free = !options.lens_free.empty();
  // Returns the share of observations that came or went.
  const auto round = [&](int iterations, double tolerance) {
    const int added = map.Complete(-1);
    if (map.num_points() < kFewestPoints) return -1.0;
    map.AdjustGlobally(iterations, tolerance, true, lens_free, true);
    const int dropped = map.Filter(current.max_error);
    report("adjustment");
    return static_cast<double>(added + dropped) / std::max(1, map.num_points());
  };
  const bool rolling = map.rolling();
  const int rounds = rolling ? kRollingRounds : kFinalRounds;
  // With velocities as many unknowns again: they wait for the end, where observations are settled.
  map.HoldVelocities(true);
  double changed = 0.0;
  // Given poses are roughly right: the largest error starts loose and gets tight, while points and,
  // if free, the lens come to fit.
  for (const double looser : kLooser) {
    if (options.lens_settled) break;
    current.max_error = looser * options.max_error;
    if (changed >= 0.0) changed = round(kIterations, kTolerance);
  }
  current.max_error = options.max_error;
  const auto settle = [&] {
    for (int i = 0; i < rounds && changed >= 0.0; ++i) {
      map.Filter(current.max_error);
      changed = round(kIterations, kTolerance);
      if (changed >= 0.0 && changed < kSettled) break;
    }
  };
  settle();
  // Bodies without a pose join once the structure stands, until no more can be placed.
  while (map.on_rig() && changed >= 0.0 && PlaceBodies(current, &map) > 0) settle();
  for (int i = 0; i < options.extend_rounds && changed >= 0.0 && HasDescriptors(images); ++i) {
    map.Extend();
    report("longer tracks");
    settle();
  }
  // Known velocities were held so far; now they may differ within their uncertainty.
  if (options.rate_sigma > 0 && !options.image_rates.empty()) {
    map.HoldVelocities(false);
    settle();
  }
  map.DropWeakImages();
  // Covariances are those of poses beside the gauge's images, which must then be there.
  const bool held = map.on_rig() || (map.registered(first) && map.registered(farthest));
  if (changed < 0.0 || map.num_points() < kFewestPoints || map.num_registered() < 2 ||
      (!held && options.covariances)) {
    return {cameras, images.size(),
            "only " + std::to_string(map.num_points()) + " points agree with the poses, and " +
                std::to_string(kFewestPoints) +
                " are needed in the first image and the one farthest from it too"};
  }
  if (!held) HoldGauge(&map);
  const bool rough = rolling || !options.covariances;
  map.AdjustFinally(kLastIterations, rough ? kRoughLastTolerance : kLastTolerance, lens_free);
  map.Filter(current.max_error);
  report("final adjustment");
  Structure result = map.Result(options.covariances);
  report("covariances");
  result.initial_first = 0;
  result.initial_second = farthest;
  return result;
}

}  // namespace gsut
