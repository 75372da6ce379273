// Keeps tracks, points and poses consistent while the structure grows.
#include "gsut/sfm/scene_map.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

constexpr double kMiddle = 0.5;  // of the readout: the time of an image's own pose
constexpr int kScoreSide = 32;   // cells of the finest grid

}  // namespace

SceneMap::SceneMap(std::vector<Camera> cameras, const std::vector<ImageFeatures>& images,
                   std::span<const VerifiedPair> pairs, const StructureOptions& options)
    : cameras_(std::move(cameras)),
      images_(images),
      options_(options),
      bearings_(images.size()),
      has_ray_(images.size()),
      tracks_of_image_(images.size()),
      cells_of_image_(images.size()),
      registered_(images.size(), 0),
      poses_(images.size()),
      camera_from_body_(options.rig.camera_from_body),
      loss_pixels_(options.max_error / kErrorOverBend) {
  // Times follow from pixels and never change; poses of lines do, with every adjustment.
  UpdateBearings();
  if (rolling()) {
    for (int image = 0; image < num_images(); ++image) {
      std::vector<double>& times = times_.emplace_back();
      for (const Eigen::Vector2d& pixel : images_[image].pixels) {
        times.push_back(TimeAt(pixel, image));
      }
      moved_.emplace_back(times.size());
    }
    velocities_.assign(images_.size(), Velocity::Zero());
  }
  for (const ImageFeatures& image : images_) {
    num_features_.push_back(static_cast<int>(image.pixels.size()));
  }
  SetTracks(BuildTracks(num_features_, pairs));
}

double SceneMap::TimeAt(const Eigen::Vector2d& pixel, int image) const {
  const Shutter& shutter =
      options_.image_shutters.empty() ? options_.shutter : options_.image_shutters[image];
  if (shutter.IsGlobal()) return 0.0;
  const Camera& camera = cameras_[images_[image].camera];
  const double time = shutter.PixelTime(pixel.x(), pixel.y(), camera.width(), camera.height());
  return options_.ReadoutOf(image) * (time - kMiddle);
}

Pose SceneMap::LinePose(int image, double time) const {
  if (!on_rig()) return MovedPose(poses_[image], velocities_[image], time);
  const Pose mount = CameraFromBody(image);
  return mount * MovedPose(mount.Inverse() * poses_[image], velocities_[image], time);
}

Velocity SceneMap::VelocityOf(int image) const {
  const double readout = options_.ReadoutOf(image);
  if (!on_rig()) return readout * velocities_[image];
  return VelocityBetween(LinePose(image, -kMiddle * readout), LinePose(image, kMiddle * readout));
}

int SceneMap::ScoreCell(const TrackElement& element) const {
  const Camera& camera = cameras_[images_[element.image].camera];
  const Eigen::Vector2d& pixel = images_[element.image].pixels[element.feature];
  const auto place = [](double at, int size) {
    return std::clamp(static_cast<int>(at / size * kScoreSide), 0, kScoreSide - 1);
  };
  return place(pixel.y(), camera.height()) * kScoreSide + place(pixel.x(), camera.width());
}

void SceneMap::SetTracks(const std::vector<std::vector<TrackElement>>& tracks) {
  tracks_.clear();
  for (std::vector<int>& of_image : tracks_of_image_) of_image.clear();
  for (std::vector<int>& of_image : cells_of_image_) of_image.clear();
  for (const auto& elements : tracks) {
    Track track;
    for (const TrackElement& element : elements) {
      track.observations.push_back({element.image, element.feature, false});
      tracks_of_image_[element.image].push_back(static_cast<int>(tracks_.size()));
      cells_of_image_[element.image].push_back(ScoreCell(element));
    }
    tracks_.push_back(std::move(track));
  }
}

int SceneMap::num_points() const {
  return static_cast<int>(
      std::count_if(tracks_.begin(), tracks_.end(), [](const Track& t) { return t.has_point; }));
}

void SceneMap::UpdateBearings() {
  ParallelFor(num_images(), 1, [&](std::int64_t i, std::int64_t) {
    bearings_[i] = MakeBearings(cameras_[images_[i].camera], images_[i].pixels, &has_ray_[i]);
  });
}

void SceneMap::Register(int image, const Pose& camera_from_world, const Velocity& velocity) {
  if (!registered_[image]) ++num_registered_;
  registered_[image] = 1;
  Place(image, camera_from_world, velocity);
}

// With a rolling shutter each feature has the pose of its own line, which is kept: residuals read
// it many times between two changes.
void SceneMap::Place(int image, const Pose& camera_from_world, const Velocity& velocity) {
  poses_[image] = camera_from_world;
  if (!rolling()) return;
  velocities_[image] = velocity;
  for (std::size_t i = 0; i < times_[image].size(); ++i) {
    moved_[image][i] = LinePose(image, times_[image][i]);
  }
}

void SceneMap::Reset() {
  std::fill(registered_.begin(), registered_.end(), 0);
  num_registered_ = 0;
  for (Track& track : tracks_) {
    track.has_point = false;
    for (Observation& observation : track.observations) observation.used = false;
  }
}

double SceneMap::Residual(const Track& track, const Observation& observation) const {
  const Pose& pose = PoseOf(observation);
  return BearingResidual(bearings_[observation.image][observation.feature],
                         pose.rotation * track.position + pose.translation)
      .norm();
}

SceneMap::Visible SceneMap::VisiblePoints(int image) const {
  Visible visible;
  for (const int index : tracks_of_image_[image]) {
    const Track& track = tracks_[index];
    if (!track.has_point) continue;
    for (const Observation& observation : track.observations) {
      if (observation.image != image || !HasRay(observation)) continue;
      visible.bearings.push_back(bearings_[image][observation.feature]);
      visible.points.push_back(track.position);
      visible.tracks.push_back(index);
    }
  }
  return visible;
}

// Points spread over the image hold a pose better than as many in a corner. Grids of 2 x 2 to 32 x
// 32 count occupied cells, a cell weighted by its grid's side (Schonberger and Frahm,
// "Structure-from- motion revisited", 2016, section 4.2).
double SceneMap::VisibleScore(int image, int* count) const {
  std::array<std::uint8_t, kScoreSide * kScoreSide> occupied{};
  *count = 0;
  for (std::size_t i = 0; i < tracks_of_image_[image].size(); ++i) {
    if (!tracks_[tracks_of_image_[image][i]].has_point) continue;
    ++*count;
    occupied[cells_of_image_[image][i]] = 1;
  }
  // Four cells of a grid are one of the next.
  int score = 0;
  for (int side = kScoreSide;; side /= 2) {
    score += side * std::accumulate(occupied.begin(), occupied.begin() + side * side, 0);
    if (side == 2) return score;
    for (int y = 0; y < side / 2; ++y) {
      for (int x = 0; x < side / 2; ++x) {
        const std::uint8_t* cell = &occupied[2 * y * side + 2 * x];
        occupied[y * (side / 2) + x] = cell[0] | cell[1] | cell[side] | cell[side + 1];
      }
    }
  }
}

// A track with a point gains the observations that agree with it now; one without is triangulated.
int SceneMap::CompleteTrack(Track* track) {
  int added = 0;
  const auto open = [&](const Observation& observation) {
    return registered_[observation.image] && HasRay(observation);
  };
  if (track->has_point) {
    for (Observation& observation : track->observations) {
      if (observation.used || !open(observation)) continue;
      observation.used = Residual(*track, observation) < options_.max_error;
      added += observation.used;
    }
    return added;
  }
  std::vector<PosedBearing> observations;
  std::vector<Observation*> from;
  for (Observation& observation : track->observations) {
    if (!open(observation)) continue;
    observations.push_back(
        {&bearings_[observation.image][observation.feature], &PoseOf(observation)});
    from.push_back(&observation);
  }
  if (observations.size() < 2) return 0;
  const TriangulatedPoint result =
      Triangulate(observations, {options_.max_error, options_.min_angle});
  if (result.num_kept < 2) return 0;
  track->has_point = true;
  track->position = result.point;
  for (std::size_t i = 0; i < from.size(); ++i) from[i]->used = result.kept[i] != 0;
  return result.num_kept;
}

// Tracks are independent, and the number of observations is a whole number: any order gives the
// same.
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

int SceneMap::Filter(double max_error) { return Filter(max_error, TracksOf(nullptr)); }

// Two conditions: an observation must be near its point's projection, and the rays that remain must
// meet at an angle, or the point's depth means nothing.
int SceneMap::Filter(double max_error, const std::vector<int>& tracks) {
  const auto count = static_cast<std::int64_t>(tracks.size());
  return static_cast<int>(
      ParallelSum(count, kTrackGrain, [&](std::int64_t begin, std::int64_t end) {
        int dropped = 0;
        std::vector<PosedBearing> observations;
        for (std::int64_t i = begin; i < end; ++i) {
          Track& track = tracks_[tracks[i]];
          if (!track.has_point) continue;
          observations.clear();
          int used = 0;
          for (Observation& observation : track.observations) {
            if (!observation.used) continue;
            if (!HasRay(observation) || !(Residual(track, observation) < max_error)) {
              observation.used = false;
              ++dropped;
              continue;
            }
            ++used;
            observations.push_back(
                {&bearings_[observation.image][observation.feature], &PoseOf(observation)});
          }
          // The point goes if too little is left of it; its features may join again later.
          const std::vector<std::uint8_t> all(observations.size(), 1);
          if (used >= 2 && ReachesAngle(observations, all, track.position, options_.min_angle)) {
            continue;
          }
          dropped += used;
          track.has_point = false;
          for (Observation& observation : track.observations) observation.used = false;
        }
        return static_cast<double>(dropped);
      }));
}

int SceneMap::DropWeakImages() {
  std::vector<int> seen(images_.size(), 0);
  for (const Track& track : tracks_) {
    if (!track.has_point) continue;
    for (const Observation& seen_by : track.observations) seen[seen_by.image] += seen_by.used;
  }
  // On a rig the body counts.
  if (on_rig()) {  // what one camera of a body sees places them all
    std::vector<int> of_body(images_.size(), 0);
    const std::vector<int>& body = options_.rig.body_of_image;
    for (int image = 0; image < num_images(); ++image) of_body[body[image]] += seen[image];
    for (int image = 0; image < num_images(); ++image) seen[image] = of_body[body[image]];
  }
  int dropped = 0;
  for (int image = 0; image < num_images(); ++image) {
    if (!registered_[image] || seen[image] >= options_.min_inliers) continue;
    registered_[image] = 0;
    --num_registered_;
    ++dropped;
    for (const int index : tracks_of_image_[image]) {
      for (Observation& observation : tracks_[index].observations) {
        if (observation.image == image) observation.used = false;
      }
    }
  }
  // Points that only the dropped images held go too.
  if (dropped > 0) Filter(options_.max_error);
  return dropped;
}

}  // namespace gsut
