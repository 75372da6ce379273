// Keeps tracks, points and poses consistent while the structure grows.
#include "gsut/poses/scene_map.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"

namespace gsut {
namespace {

constexpr std::int64_t kTrackGrain = 256;  // tracks a chunk of parallel work
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
// Cauchy's loss bends at this fraction of the largest error before residuals are known, and never
// below this many pixels.
constexpr double kStartLoss = 4.0;
constexpr double kLeastLoss = 0.02;
constexpr int kScoreLevels = 5;  // grids of 2 x 2 to 32 x 32 cells

}  // namespace

SceneMap::SceneMap(std::vector<Camera> cameras, const std::vector<ImageFeatures>& images,
                   std::span<const VerifiedPair> pairs, const StructureOptions& options)
    : cameras_(std::move(cameras)),
      images_(images),
      options_(options),
      bearings_(images.size()),
      has_ray_(images.size()),
      tracks_of_image_(images.size()),
      registered_(images.size(), 0),
      poses_(images.size()),
      loss_pixels_(options.max_error / kStartLoss) {
  UpdateBearings();
  std::vector<int> counts;
  for (const ImageFeatures& image : images_)
    counts.push_back(static_cast<int>(image.pixels.size()));
  int judged = 0;
  for (const auto& elements : BuildTracks(counts, pairs)) {
    Track track;
    for (const TrackElement& element : elements) {
      track.sights.push_back({element.image, element.feature, false, false});
      tracks_of_image_[element.image].push_back(static_cast<int>(tracks_.size()));
    }
    if (options_.hold_out_every > 0 && track.sights.size() >= 4 &&
        judged++ % options_.hold_out_every == 0) {
      track.sights[judged % track.sights.size()].held_out = true;
    }
    tracks_.push_back(std::move(track));
  }
}

int SceneMap::num_points() const {
  return static_cast<int>(
      std::count_if(tracks_.begin(), tracks_.end(), [](const Track& t) { return t.has_point; }));
}

void SceneMap::UpdateBearings() {
  for (std::size_t i = 0; i < images_.size(); ++i) {
    bearings_[i] = MakeBearings(cameras_[images_[i].camera], images_[i].pixels, &has_ray_[i]);
  }
}

void SceneMap::UpdateLoss() {
  std::vector<double> lengths;
  for (const Track& track : tracks_) {
    if (!track.has_point) continue;
    for (const Sight& sight : track.sights) {
      if (sight.used) lengths.push_back(Residual(track, sight));
    }
  }
  if (lengths.empty()) return;
  const auto middle = lengths.begin() + static_cast<std::ptrdiff_t>(lengths.size() / 2);
  std::nth_element(lengths.begin(), middle, lengths.end());
  loss_pixels_ = std::clamp(options_.loss_scale * *middle, kLeastLoss,
                            std::max(kLeastLoss, options_.max_error / kStartLoss));
}

void SceneMap::Register(int image, const Pose& camera_from_world) {
  if (!registered_[image]) ++num_registered_;
  registered_[image] = 1;
  poses_[image] = camera_from_world;
}

void SceneMap::Reset() {
  std::fill(registered_.begin(), registered_.end(), 0);
  num_registered_ = 0;
  for (Track& track : tracks_) {
    track.has_point = false;
    for (Sight& sight : track.sights) sight.used = false;
  }
}

double SceneMap::Residual(const Track& track, const Sight& sight) const {
  const Pose& pose = poses_[sight.image];
  return BearingResidual(bearings_[sight.image][sight.feature],
                         pose.rotation * track.position + pose.translation)
      .norm();
}

SceneMap::Visible SceneMap::VisiblePoints(int image) const {
  Visible visible;
  for (const int index : tracks_of_image_[image]) {
    const Track& track = tracks_[index];
    if (!track.has_point) continue;
    for (const Sight& sight : track.sights) {
      if (sight.image != image || sight.held_out || !HasRay(sight)) continue;
      visible.bearings.push_back(bearings_[image][sight.feature]);
      visible.points.push_back(track.position);
      visible.tracks.push_back(index);
    }
  }
  return visible;
}

double SceneMap::VisibleScore(int image, int* count) const {
  std::array<std::vector<std::uint8_t>, kScoreLevels> cells;
  for (int level = 0; level < kScoreLevels; ++level) cells[level].assign(4ULL << (2 * level), 0);
  const Camera& camera = cameras_[images_[image].camera];
  double score = 0.0;
  *count = 0;
  for (const int index : tracks_of_image_[image]) {
    const Track& track = tracks_[index];
    if (!track.has_point) continue;
    for (const Sight& sight : track.sights) {
      if (sight.image != image) continue;
      ++*count;
      const Eigen::Vector2d& pixel = images_[image].pixels[sight.feature];
      for (int level = 0; level < kScoreLevels; ++level) {
        const int side = 2 << level;
        const int x = std::clamp(static_cast<int>(pixel.x() / camera.width() * side), 0, side - 1);
        const int y = std::clamp(static_cast<int>(pixel.y() / camera.height() * side), 0, side - 1);
        std::uint8_t& cell = cells[level][y * side + x];
        if (!cell) score += side;
        cell = 1;
      }
    }
  }
  return score;
}

int SceneMap::CompleteTrack(Track* track) {
  int added = 0;
  const auto open = [&](const Sight& sight) {
    return registered_[sight.image] && !sight.held_out && HasRay(sight);
  };
  if (track->has_point) {
    for (Sight& sight : track->sights) {
      if (sight.used || !open(sight)) continue;
      sight.used = Residual(*track, sight) < options_.max_error;
      added += sight.used;
    }
    return added;
  }
  std::vector<gsut::Sight> sights;
  std::vector<Sight*> from;
  for (Sight& sight : track->sights) {
    if (!open(sight)) continue;
    sights.push_back({&bearings_[sight.image][sight.feature], &poses_[sight.image]});
    from.push_back(&sight);
  }
  if (sights.size() < 2) return 0;
  const TriangulatedPoint result = Triangulate(sights, {options_.max_error, options_.min_angle});
  if (result.num_kept < 2) return 0;
  track->has_point = true;
  track->position = result.point;
  for (std::size_t i = 0; i < from.size(); ++i) from[i]->used = result.kept[i] != 0;
  return result.num_kept;
}

int SceneMap::Complete(int image) {
  const std::int64_t count = image < 0 ? static_cast<std::int64_t>(tracks_.size())
                                       : static_cast<std::int64_t>(tracks_of_image_[image].size());
  return static_cast<int>(
      ParallelSum(count, kTrackGrain, [&](std::int64_t begin, std::int64_t end) {
        int added = 0;
        for (std::int64_t i = begin; i < end; ++i) {
          added += CompleteTrack(&tracks_[image < 0 ? i : tracks_of_image_[image][i]]);
        }
        return static_cast<double>(added);
      }));
}

int SceneMap::Filter(double max_error) {
  const auto count = static_cast<std::int64_t>(tracks_.size());
  return static_cast<int>(
      ParallelSum(count, kTrackGrain, [&](std::int64_t begin, std::int64_t end) {
        int dropped = 0;
        std::vector<gsut::Sight> sights;
        for (std::int64_t i = begin; i < end; ++i) {
          Track& track = tracks_[i];
          if (!track.has_point) continue;
          sights.clear();
          int used = 0;
          for (Sight& sight : track.sights) {
            if (!sight.used) continue;
            if (!HasRay(sight) || !(Residual(track, sight) < max_error)) {
              sight.used = false;
              ++dropped;
              continue;
            }
            ++used;
            sights.push_back({&bearings_[sight.image][sight.feature], &poses_[sight.image]});
          }
          const std::vector<std::uint8_t> all(sights.size(), 1);
          if (used >= 2 && TriangulationAngle(sights, all, track.position) >= options_.min_angle) {
            continue;
          }
          dropped += used;
          track.has_point = false;
          for (Sight& sight : track.sights) sight.used = false;
        }
        return static_cast<double>(dropped);
      }));
}

int SceneMap::DropWeakImages() {
  std::vector<int> seen(images_.size(), 0);
  for (const Track& track : tracks_) {
    if (!track.has_point) continue;
    for (const Sight& sight : track.sights) seen[sight.image] += sight.used;
  }
  int dropped = 0;
  for (int image = 0; image < num_images(); ++image) {
    if (!registered_[image] || seen[image] >= options_.min_inliers) continue;
    registered_[image] = 0;
    --num_registered_;
    ++dropped;
    for (const int index : tracks_of_image_[image]) {
      for (Sight& sight : tracks_[index].sights) {
        if (sight.image == image) sight.used = false;
      }
    }
  }
  if (dropped > 0) Filter(options_.max_error);
  return dropped;
}

Bundle SceneMap::MakeBundle(const std::vector<std::uint8_t>* images_free, BundleOptions* options,
                            std::vector<int>* image_of, std::vector<int>* track_of) const {
  Bundle bundle;
  bundle.cameras = cameras_;
  std::vector<int> place(images_.size(), -1);
  for (std::size_t t = 0; t < tracks_.size(); ++t) {
    const Track& track = tracks_[t];
    if (!track.has_point) continue;
    const bool wanted =
        images_free == nullptr ||
        std::any_of(track.sights.begin(), track.sights.end(), [&](const Sight& sight) {
          return sight.used && (*images_free)[sight.image] != 0;
        });
    if (!wanted) continue;
    const int point = static_cast<int>(bundle.points.size());
    bundle.points.push_back(track.position);
    track_of->push_back(static_cast<int>(t));
    for (const Sight& sight : track.sights) {
      if (!sight.used) continue;
      int& image = place[sight.image];
      if (image < 0) {
        image = static_cast<int>(image_of->size());
        image_of->push_back(sight.image);
        bundle.camera_of_image.push_back(images_[sight.image].camera);
        bundle.camera_from_world.push_back(poses_[sight.image]);
        if (images_free != nullptr) {
          options->image_fixed.push_back((*images_free)[sight.image] == 0);
        }
      }
      bundle.observations.push_back({image, point, bearings_[sight.image][sight.feature],
                                     images_[sight.image].pixels[sight.feature]});
    }
  }
  options->loss_scale = loss_pixels_;
  options->num_threads = NumThreads();
  const auto placed = [&](int image) { return image < 0 ? -1 : place[image]; };
  options->gauge_image = placed(gauge_first_);
  options->scale_image = placed(gauge_second_);
  if (images_free != nullptr) {
    const auto fixed = std::count(options->image_fixed.begin(), options->image_fixed.end(), 1);
    if (fixed >= 2) options->gauge_image = options->scale_image = -1;
  }
  return bundle;
}

void SceneMap::TakeBack(const Bundle& bundle, const std::vector<int>& image_of,
                        const std::vector<int>& track_of) {
  for (std::size_t i = 0; i < image_of.size(); ++i) {
    poses_[image_of[i]] = bundle.camera_from_world[i];
  }
  for (std::size_t i = 0; i < track_of.size(); ++i) {
    tracks_[track_of[i]].position = bundle.points[i];
  }
}

void SceneMap::AdjustLocally(int image) {
  std::vector<int> shared(images_.size(), 0);
  for (const int index : tracks_of_image_[image]) {
    const Track& track = tracks_[index];
    if (!track.has_point) continue;
    for (const Sight& sight : track.sights) shared[sight.image] += sight.used;
  }
  shared[image] = 0;
  std::vector<int> order(images_.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return shared[a] > shared[b]; });
  std::vector<std::uint8_t> free(images_.size(), 0);
  free[image] = 1;
  for (int i = 0; i + 1 < options_.local_images && i < num_images(); ++i) {
    if (shared[order[i]] > 0) free[order[i]] = 1;
  }
  BundleOptions options;
  constexpr int kLocalIterations = 12;
  constexpr double kLocalTolerance = 1e-4;
  options.max_iterations = kLocalIterations;
  options.function_tolerance = kLocalTolerance;
  std::vector<int> image_of, track_of;
  Bundle bundle = MakeBundle(&free, &options, &image_of, &track_of);
  AdjustBundle(&bundle, options);
  TakeBack(bundle, image_of, track_of);
}

BundleSummary SceneMap::AdjustGlobally(int max_iterations, double tolerance, bool through_lens,
                                       bool lens_free) {
  BundleOptions options;
  options.max_iterations = max_iterations;
  options.function_tolerance = tolerance;
  options.through_lens = through_lens || lens_free;
  if (lens_free) options.lens_free = options_.lens_free;
  std::vector<int> image_of, track_of;
  Bundle bundle = MakeBundle(nullptr, &options, &image_of, &track_of);
  const BundleSummary summary = AdjustBundle(&bundle, options);
  TakeBack(bundle, image_of, track_of);
  if (lens_free) {
    cameras_ = bundle.cameras;
    UpdateBearings();
  }
  UpdateLoss();
  return summary;
}

Structure SceneMap::Result(bool covariances) const {
  Structure result;
  result.cameras = cameras_;
  result.registered = registered_;
  result.camera_from_world.resize(images_.size());
  for (int image = 0; image < num_images(); ++image) {
    if (registered_[image]) result.camera_from_world[image] = poses_[image];
  }
  std::vector<double> lengths, held_out;
  for (const Track& track : tracks_) {
    if (!track.has_point) continue;
    StructurePoint point;
    point.position = track.position;
    for (const Sight& sight : track.sights) {
      if (!sight.used && !(sight.held_out && registered_[sight.image] && HasRay(sight))) continue;
      const double length = Residual(track, sight);
      if (sight.held_out) {
        held_out.push_back(length);
        point.held_out.push_back({sight.image, sight.feature});
        continue;
      }
      lengths.push_back(length);
      point.error += length;
      point.sights.push_back({sight.image, sight.feature});
    }
    point.error /= static_cast<double>(std::max<std::size_t>(1, point.sights.size()));
    result.points.push_back(std::move(point));
  }
  const auto median = [](std::vector<double>* values) {
    if (values->empty()) return 0.0;
    const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
    std::nth_element(values->begin(), middle, values->end());
    return *middle;
  };
  for (const double length : lengths) result.rms += length * length;
  if (!lengths.empty()) result.rms = std::sqrt(result.rms / static_cast<double>(lengths.size()));
  result.median = median(&lengths);
  result.held_out = median(&held_out);
  result.num_held_out = static_cast<int>(held_out.size());
  result.covariances.assign(images_.size(), Eigen::Matrix<double, 6, 6>::Zero());
  if (covariances && num_registered_ >= 2) {
    BundleOptions options;
    std::vector<int> image_of, track_of;
    const Bundle bundle = MakeBundle(nullptr, &options, &image_of, &track_of);
    try {
      const auto found = PoseCovariances(bundle, options);
      for (std::size_t i = 0; i < image_of.size(); ++i) result.covariances[image_of[i]] = found[i];
    } catch (const SolveError&) {  // something is not determined: said by NaN
      for (const int image : image_of) result.covariances[image].setConstant(kNaN);
    }
  }
  return result;
}

}  // namespace gsut
