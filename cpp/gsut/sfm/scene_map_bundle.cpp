// The growing structure as a bundle: all of it, what is around an image, or a spread choice of
// tracks.
#include <algorithm>

#include "gsut/base/parallel.h"
#include "gsut/sfm/scene_map.h"

namespace gsut {
namespace {

// Cells a side of the grid over an image in which tracks are counted, and tracks that fill a cell.
// 8 x 8 x 3 observations hold a pose to a fraction of a pixel.
constexpr int kCells = 8;
constexpr int kCellTracks = 3;
// Iterations with all tracks after an adjustment of the chosen ones has converged: steps are then
// small, and each at least halves what is left.
constexpr int kFullIterations = 4;
// Relative decrease of the cost at which that adjustment has.
constexpr double kThinTolerance = 1e-5;

}  // namespace

void SceneMap::AddImage(int image, Bundle* bundle, std::vector<int>* image_of) const {
  image_of->push_back(image);
  bundle->camera_of_image.push_back(images_[image].camera);
  bundle->camera_from_world.push_back(poses_[image]);
  if (rolling()) bundle->velocities.push_back(velocities_[image]);
}

// Tracks whose points take part, in order: those that a free image sees, or all.
std::vector<int> SceneMap::TracksOf(const std::vector<std::uint8_t>* images_free) const {
  std::vector<int> found;
  if (images_free == nullptr) {
    for (std::size_t t = 0; t < tracks_.size(); ++t) {
      if (tracks_[t].has_point) found.push_back(static_cast<int>(t));
    }
    return found;
  }
  for (int image = 0; image < num_images(); ++image) {
    if (!(*images_free)[image]) continue;
    for (const int t : tracks_of_image_[image]) {
      if (!tracks_[t].has_point) continue;
      const auto& all = tracks_[t].observations;
      const bool seen = std::any_of(all.begin(), all.end(), [&](const Observation& observation) {
        return observation.used && observation.image == image;
      });
      if (seen) found.push_back(t);
    }
  }
  std::sort(found.begin(), found.end());
  found.erase(std::unique(found.begin(), found.end()), found.end());
  return found;
}

// Copies the points of these tracks, and what sees them, into a bundle with numbers of its own.
// images_free: the images that move, the others are held; null: all move.
Bundle SceneMap::MakeBundle(const std::vector<std::uint8_t>* images_free,
                            const std::vector<int>& tracks, BundleOptions* options,
                            std::vector<int>* image_of) const {
  Bundle bundle;
  bundle.cameras = cameras_;
  std::vector<int> place(images_.size(), -1);
  std::vector<std::size_t> begin(1, 0);  // by point the first of its observations
  for (const int t : tracks) {
    const Track& track = tracks_[t];
    bundle.points.push_back(track.position);
    begin.push_back(begin.back());
    for (const Observation& observation : track.observations) {
      if (!observation.used) continue;
      ++begin.back();
      int& image = place[observation.image];
      if (image >= 0) continue;
      image = static_cast<int>(image_of->size());
      AddImage(observation.image, &bundle, image_of);
      if (images_free != nullptr) {
        options->image_fixed.push_back((*images_free)[observation.image] == 0);
      }
    }
  }
  // Now that images have numbers, points copy their observations beside each other.
  bundle.observations.resize(begin.back());
  const auto points = static_cast<std::int64_t>(tracks.size());
  ParallelFor(points, kTrackGrain, [&](std::int64_t first, std::int64_t last) {
    for (std::int64_t point = first; point < last; ++point) {
      std::size_t at = begin[point];
      for (const Observation& observation : tracks_[tracks[point]].observations) {
        if (!observation.used) continue;
        bundle.observations[at++] = {place[observation.image],
                                     static_cast<int>(point),
                                     bearings_[observation.image][observation.feature],
                                     images_[observation.image].pixels[observation.feature],
                                     TimeOf(observation),
                                     NoiseOf(observation)};
      }
    }
  });
  // With two held images the gauge needs no more.
  const auto placed = [&](int image) { return image < 0 ? -1 : place[image]; };
  options->gauge_image = placed(gauge_first_);
  options->scale_image = placed(gauge_second_);
  if (on_rig()) AddRig(&bundle, options, image_of);
  options->loss_scale = loss_pixels_;
  if (rolling()) SetPriors(bundle, *image_of, options);
  if (images_free == nullptr && !options_.places.empty()) SetPlacePriors(*image_of, options);
  if (images_free == nullptr && !on_rig()) SetPointPriors(tracks, options);
  if (images_free == nullptr && !options_.turns.empty()) SetTurnPriors(place, options);
  if (!options_.lens_priors.empty()) SetLensPriors(options);
  if (images_free != nullptr) {
    const auto fixed = std::count(options->image_fixed.begin(), options->image_fixed.end(), 1);
    if (fixed >= 2) options->gauge_image = options->scale_image = -1;
  }
  return bundle;
}

void SceneMap::StoreBundle(const Bundle& bundle, const std::vector<int>& image_of,
                           const std::vector<int>& tracks) {
  if (on_rig()) camera_from_body_ = bundle.camera_from_body;  // which poses of lines follow
  ParallelFor(static_cast<std::int64_t>(image_of.size()), 1, [&](std::int64_t i, std::int64_t) {
    Place(image_of[i], bundle.camera_from_world[i],
          rolling() ? bundle.velocities[i] : Velocity::Zero());
  });
  for (std::size_t i = 0; i < tracks.size(); ++i) tracks_[tracks[i]].position = bundle.points[i];
  if (on_rig() && options_.rig.refine) RestoreRigSize(bundle);
}

bool SceneMap::ThinsOut() const { return num_registered_ >= options_.thin_from && !on_rig(); }

void SceneMap::AdjustFinally(int max_iterations, double tolerance, bool lens_free) {
  if (ThinsOut()) {
    AdjustGlobally(max_iterations, std::max(tolerance, kThinTolerance), true, lens_free, true);
    max_iterations = kFullIterations;
  }
  AdjustGlobally(max_iterations, tolerance, true, lens_free, false);
}

// Long tracks hold poses together, and tracks spread over an image hold its pose: tracks are taken
// from the longest on, as long as they are in a cell of an image that is not yet full. Every image
// keeps observations wherever it has some.
std::vector<int> SceneMap::ChooseSpread() const {
  const std::vector<int> all = TracksOf(nullptr);
  std::vector<int> lengths(tracks_.size(), 0);
  for (const int t : all) {
    for (const Observation& observation : tracks_[t].observations) lengths[t] += observation.used;
  }
  std::vector<int> order = all;
  std::stable_sort(order.begin(), order.end(),
                   [&](int a, int b) { return lengths[a] > lengths[b]; });
  std::vector<std::uint8_t> filled(images_.size() * kCells * kCells, 0);
  const auto cell_of = [&](const Observation& observation) -> std::uint8_t& {
    const Camera& camera = cameras_[images_[observation.image].camera];
    const Eigen::Vector2d& pixel = images_[observation.image].pixels[observation.feature];
    const auto place = [](double at, int size) {
      return std::clamp(static_cast<int>(at / size * kCells), 0, kCells - 1);
    };
    const int cell = place(pixel.y(), camera.height()) * kCells + place(pixel.x(), camera.width());
    return filled[observation.image * kCells * kCells + cell];
  };
  const std::vector<int> stated = StatedTracks();
  std::vector<int> chosen;
  for (const int t : order) {
    const auto& observations = tracks_[t].observations;
    const bool is_needed =
        std::find(stated.begin(), stated.end(), t) != stated.end() ||
        std::any_of(observations.begin(), observations.end(), [&](const Observation& observation) {
          return observation.used && cell_of(observation) < kCellTracks;
        });
    if (!is_needed) continue;
    chosen.push_back(t);
    for (const Observation& observation : observations) {
      if (!observation.used) continue;
      std::uint8_t& count = cell_of(observation);
      count = std::min<std::uint8_t>(count + 1, kCellTracks);
    }
  }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

std::vector<int> SceneMap::StatedTracks() const {
  std::vector<int> found;
  for (const StatedPoint& point : options_.stated_points) {
    const std::vector<int>& own = tracks_of_image_[point.seen.image];
    const auto at = std::find_if(own.begin(), own.end(), [&](int t) {
      return std::any_of(tracks_[t].observations.begin(), tracks_[t].observations.end(),
                         [&](const Observation& observation) {
                           return observation.image == point.seen.image &&
                                  observation.feature == point.seen.feature;
                         });
    });
    found.push_back(at == own.end() ? -1 : *at);
  }
  return found;
}

// Three points fix the gauge.
void SceneMap::SetPointPriors(const std::vector<int>& tracks, BundleOptions* options) const {
  constexpr std::size_t kFewest = 3;
  const std::vector<int> stated = StatedTracks();
  std::vector<PointPrior> priors;
  for (std::size_t i = 0; i < stated.size(); ++i) {
    const auto at = std::lower_bound(tracks.begin(), tracks.end(), stated[i]);
    if (at == tracks.end() || *at != stated[i]) continue;
    const StatedPoint& point = options_.stated_points[i];
    priors.push_back({static_cast<int>(at - tracks.begin()), point.mean, point.sigma});
  }
  if (priors.size() < kFewest) return;
  options->gauge_image = options->scale_image = -1;
  const double scale = ScaleOfSigmas(options);
  for (PointPrior& prior : priors) prior.sigma *= scale;
  options->point_priors = std::move(priors);
}

// Points that took no part move with the first image that sees them, then to where all observations
// want them.
void SceneMap::PlaceOthers(const std::vector<int>& adjusted, const std::vector<Pose>& before) {
  std::vector<std::uint8_t> done(tracks_.size(), 0);
  for (const int t : adjusted) done[t] = 1;
  const auto count = static_cast<std::int64_t>(tracks_.size());
  ParallelFor(count, kTrackGrain, [&](std::int64_t begin, std::int64_t end) {
    std::vector<PosedBearing> observations;
    for (std::int64_t t = begin; t < end; ++t) {
      Track& track = tracks_[t];
      if (!track.has_point || done[t]) continue;
      observations.clear();
      int first = -1;
      for (const Observation& observation : track.observations) {
        if (!observation.used) continue;
        if (first < 0) first = observation.image;
        if (!HasRay(observation)) continue;
        observations.push_back(
            {&bearings_[observation.image][observation.feature], &PoseOf(observation)});
      }
      const Pose moved = poses_[first].Inverse() * before[first];
      track.position = moved.rotation * track.position + moved.translation;
      Eigen::Vector3d refined = track.position;
      const std::vector<std::uint8_t> all(observations.size(), 1);
      if (observations.size() >= 2 && RefinePoint(observations, all, &refined)) {
        track.position = refined;
      }
    }
  });
}

}  // namespace gsut
