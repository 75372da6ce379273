// Looks for points in images that do not see them yet: longer tracks, and fewer of one point.
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "gsut/base/parallel.h"
#include "gsut/sfm/match.h"
#include "gsut/sfm/scene_map.h"

namespace gsut {
namespace {

using Descriptor = Eigen::Matrix<float, kDescriptorLength, 1>;

constexpr double kLeastCell = 8.0;  // pixels: side of the cells that features are sorted into

Descriptor UnitDescriptor(const ImageFeatures& image, int feature) {
  const std::uint8_t* values = image.descriptors + std::size_t{kDescriptorLength} * feature;
  Descriptor descriptor;
  for (int k = 0; k < kDescriptorLength; ++k) descriptor[k] = static_cast<float>(values[k]);
  return descriptor.normalized();
}

// Cells as wide as the radius or wider: what is near lies in the nine cells around.
// The features of an image by place.
class FeatureGrid {
 public:
  FeatureGrid(const ImageFeatures& image, double radius)
      : image_(image), radius_(radius), cell_(std::max(radius, kLeastCell)) {
    for (std::size_t i = 0; i < image.pixels.size(); ++i) {
      cells_[Cell(image.pixels[i])].push_back(static_cast<int>(i));
    }
  }

  // Calls visit(feature) for the features within the radius.
  template <class Visit>
  void Near(const Eigen::Vector2d& pixel, const Visit& visit) const {
    const std::array<int, 2> center = Cell(pixel);
    for (int y = -1; y <= 1; ++y) {
      for (int x = -1; x <= 1; ++x) {
        const auto found = cells_.find({center[0] + x, center[1] + y});
        if (found == cells_.end()) continue;
        for (const int feature : found->second) {
          if ((image_.pixels[feature] - pixel).norm() < radius_) visit(feature);
        }
      }
    }
  }

 private:
  std::array<int, 2> Cell(const Eigen::Vector2d& pixel) const {
    return {static_cast<int>(std::floor(pixel.x() / cell_)),
            static_cast<int>(std::floor(pixel.y() / cell_))};
  }

  const ImageFeatures& image_;
  double radius_, cell_;
  std::map<std::array<int, 2>, std::vector<int>> cells_;
};

}  // namespace

// Matching from image to image misses features whose neighbours look alike or whose view has
// turned. A point that is already known says where to look: its projection, within a few pixels,
// leaves few features, and a looser descriptor distance then suffices.
std::vector<SceneMap::Candidate> SceneMap::CandidatesIn(int image,
                                                        const Eigen::MatrixXf& descriptors) const {
  std::vector<std::uint8_t> seen(tracks_.size(), 0);
  for (const int index : tracks_of_image_[image]) {
    for (const Observation& observation : tracks_[index].observations) {
      if (observation.image == image && observation.used) seen[index] = 1;
    }
  }
  const Camera& camera = cameras_[images_[image].camera];
  const FeatureGrid grid(images_[image], options_.extend_radius);
  const auto most = static_cast<float>(options_.extend_distance * options_.extend_distance);
  std::vector<Candidate> candidates;
  for (std::size_t t = 0; t < tracks_.size(); ++t) {
    if (!tracks_[t].has_point || seen[t]) continue;
    // With a rolling shutter the line that sees the point, and so the pose, follow from the pixel.
    constexpr int kRollingRounds = 4;
    Eigen::Vector2d pixel;
    std::uint8_t valid = 0;
    double time = 0.0;
    for (int round = 0; round < (rolling() ? kRollingRounds : 1); ++round) {
      const Pose pose = rolling() ? LinePose(image, time) : poses_[image];
      const Eigen::Vector3d p = pose.rotation * tracks_[t].position + pose.translation;
      camera.Project(1, p.data(), pixel.data(), &valid);
      if (!valid) break;
      time = TimeAt(pixel, image);
    }
    if (!valid) continue;
    Candidate best = {static_cast<int>(t), -1, most};
    grid.Near(pixel, [&](int feature) {
      if (!has_ray_[image][feature]) return;
      const float squared = 2.0F - 2.0F * descriptors.col(static_cast<Eigen::Index>(t))
                                              .dot(UnitDescriptor(images_[image], feature));
      if (squared < best.squared) best = {best.track, feature, squared};
    });
    if (best.feature >= 0) candidates.push_back(best);
  }
  return candidates;
}

int SceneMap::Extend() {
  // What a point looks like: the mean of its observations.
  Eigen::MatrixXf descriptors =
      Eigen::MatrixXf::Zero(kDescriptorLength, static_cast<Eigen::Index>(tracks_.size()));
  std::vector<TrackJoin> joins;
  std::vector<TrackElement> first(tracks_.size());
  for (std::size_t t = 0; t < tracks_.size(); ++t) {
    if (!tracks_[t].has_point) continue;
    auto column = descriptors.col(static_cast<Eigen::Index>(t));
    bool found = false;
    for (const Observation& observation : tracks_[t].observations) {
      if (!observation.used) continue;
      const TrackElement element = {observation.image, observation.feature};
      if (found) joins.push_back({first[t], element});
      if (!found) first[t] = element;
      found = true;
      column += UnitDescriptor(images_[observation.image], observation.feature);
    }
    column.normalize();
  }
  std::vector<std::vector<Candidate>> of_image(images_.size());
  ParallelFor(num_images(), 1, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t image = begin; image < end; ++image) {
      if (registered_[image]) of_image[image] = CandidatesIn(static_cast<int>(image), descriptors);
    }
  });
  // The most alike are joined first.
  struct Found {
    float squared;
    TrackJoin join;
  };
  std::vector<Found> found;
  for (int image = 0; image < num_images(); ++image) {
    for (const Candidate& candidate : of_image[image]) {
      // A join to the track's first feature joins it to all of them.
      const TrackElement& own = first[candidate.track];
      if (own.image == image) continue;  // its own observation there no longer agrees
      found.push_back({candidate.squared, {own, {image, candidate.feature}}});
    }
  }
  std::stable_sort(found.begin(), found.end(),
                   [](const Found& a, const Found& b) { return a.squared < b.squared; });
  for (const Found& one : found) joins.push_back(one.join);
  // Tracks are made anew from the old joins, first, and the found ones: two points whose features
  // join become one, unless they are seen in one image.
  SetTracks(JoinTracks(num_features_, joins));
  Complete(-1);
  return static_cast<int>(found.size());
}

}  // namespace gsut
