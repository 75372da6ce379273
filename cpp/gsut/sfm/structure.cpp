// Incremental structure from motion: first pair, one image after the other, adjustment in between.
#include "gsut/sfm/structure.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>
#include <optional>

#include "gsut/base/errors.h"
#include "gsut/sfm/absolute_pose.h"
#include "gsut/sfm/relative_pose.h"
#include "gsut/sfm/scene_map.h"

namespace gsut {
namespace {

// More parallax than this (radians, 20 degrees) makes a first pair no better.
constexpr double kEnoughParallax = 0.35;
// Points that a first pair must give; fewer make a shaky start.
constexpr int kInitialPoints = 30;
// Share of a pair's matches that a rotation explains, above which the pair is no start.
constexpr double kMostRotation = 0.7;
// Iterations of the first adjustment: two images are cheap, and all later ones build on them.
constexpr int kPairIterations = 20;
// Iterations of an adjustment while the structure grows; the next image moves everything again.
constexpr int kGlobalIterations = 10;
// Relative decrease of the cost at which an adjustment of the growing structure stops.
constexpr double kGlobalTolerance = 1e-4;
// Points grow faster than images: everything is adjusted again when there are this many times
// `global_growth` as many of them.
constexpr double kPointGrowth = 1.5;
// An image whose registration failed is tried again with this many times as many points: fewer
// would most likely fail as before.
constexpr double kRetryGrowth = 1.25;
// Iterations of an adjustment of the complete structure, which rarely needs them all.
constexpr int kFinalIterations = 30;
// Relative decrease of the last cost: poses no longer change by anything that matters.
constexpr double kFinalTolerance = 1e-6;
// Rounds of adjusting, dropping outliers and completing tracks; most scenes settle in two.
constexpr int kFinalRounds = 3;
// Relative decrease of the cost between rounds that change the observations anyway.
constexpr double kExtendTolerance = 1e-4;
// Below this share of new observations, completing tracks again changes nothing.
constexpr double kSettled = 5e-4;
// Rolling shutters: the largest error while the structure grows, in units of the final one.
constexpr int kGrowingError = 4;
// Where the camera turned from one picture to the next, an image sees too few points. It is then
// placed by its pose relative to the registered image with which it has at least this many matches.
constexpr int kPairMatches = 60;
// Only the length of that motion comes from points: one would do, this many guard against an error.
constexpr int kPairPoints = 3;
// Share of the points the image sees that must agree with that length.
constexpr double kPairShare = 0.4;
// How far off such points may be, in largest errors: two images alone place them poorly.
constexpr double kPairError = 2.5;
// Images from which lenses are adjusted in full; before, too little holds them.
constexpr int kLensImages = 5;

class Mapper {
 public:
  Mapper(const std::vector<Camera>& cameras, const std::vector<ImageFeatures>& images,
         std::span<const VerifiedPair> pairs, const StructureOptions& options,
         const std::function<bool(const StructureProgress&)>& on_progress)
      : cameras_(cameras),
        images_(images),
        pairs_(pairs),
        wanted_(options),
        options_(options),
        on_progress_(on_progress) {}

  Structure Run() {
    std::optional<Structure> best;
    int restarts = 0;
    int trials = 0;
    std::string failure;
    for (const int pair : InitialPairs(&failure)) {
      if (trials >= options_.initial_trials || restarts > options_.most_restarts) break;
      // Another beginning within what was found would find the same again.
      if (best && best->registered[pairs_[pair].first] && best->registered[pairs_[pair].second]) {
        continue;
      }
      ++trials;
      map_ = std::make_unique<SceneMap>(cameras_, images_, pairs_, options_);
      tried_at_.assign(images_.size(), -1);
      by_pair_.assign(images_.size(), 0);
      if (!Start(pairs_[pair])) continue;
      Grow();
      Structure result = Finish();
      result.initial_first = pairs_[pair].first;
      result.initial_second = pairs_[pair].second;
      const auto rank = [](const Structure& s) {
        return std::make_pair(std::count(s.registered.begin(), s.registered.end(), 1),
                              s.points.size());
      };
      if (!best || rank(result) > rank(*best)) best = std::move(result);
      const auto registered = static_cast<double>(rank(*best).first);
      if (registered >= options_.enough_registered * NumMatched()) break;
      ++restarts;
    }
    if (best) {
      best->restarts = std::min(restarts, options_.most_restarts);
      return *best;
    }
    if (failure.empty()) failure = "no pair of images gave a stable first triangulation";
    return {cameras_, images_.size(), failure};
  }

 private:
  // Images with matches: no other can be registered.
  double NumMatched() const {
    std::vector<std::uint8_t> matched(images_.size(), 0);
    for (const VerifiedPair& pair : pairs_) matched[pair.first] = matched[pair.second] = 1;
    return static_cast<double>(std::count(matched.begin(), matched.end(), 1));
  }

  std::vector<int> InitialPairs(std::string* failure) const {
    std::vector<int> order;
    for (std::size_t i = 0; i < pairs_.size(); ++i) {
      const VerifiedPair& pair = pairs_[i];
      if (pair.num_rotation_inliers <= kMostRotation * static_cast<double>(pair.matches.size())) {
        order.push_back(static_cast<int>(i));
      }
    }
    if (pairs_.empty()) {
      *failure = "no two images have matches that agree";
    } else if (order.empty()) {
      *failure =
          "every pair of images with matches differs by a rotation only, so there is no depth";
    }
    const auto score = [&](int i) {
      const VerifiedPair& pair = pairs_[i];
      const double moved = static_cast<double>(pair.matches.size()) - pair.num_rotation_inliers;
      return std::sqrt(static_cast<double>(pair.matches.size())) * std::sqrt(moved) *
             std::min(pair.parallax, kEnoughParallax);
    };
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return score(a) > score(b); });
    return order;
  }

  // Rolling shutters: the largest error now, in units of the wanted one; global ones keep to it.
  void SetErrorFactor(double factor) {
    const bool rolling = !wanted_.shutter.IsGlobal();
    options_.max_error = wanted_.max_error * (rolling ? factor : 1.0);
  }

  // Two images, their points, and an adjustment: unless enough points remain, another pair is
  // better.
  bool Start(const VerifiedPair& pair) {
    SetErrorFactor(wanted_.rolling_error);
    map_->SetGauge(pair.first, pair.second);
    map_->Register(pair.first, Pose());
    map_->Register(pair.second, pair.second_from_first);
    map_->Complete(pair.first);
    if (map_->num_points() < kInitialPoints) return false;
    map_->AdjustGlobally(kPairIterations, kGlobalTolerance, false, false, true);
    map_->Filter(options_.max_error);
    if (map_->num_points() < kInitialPoints) return false;
    SetErrorFactor(kGrowingError);
    ReportProgress("first pair");
    return true;
  }

  void Grow() {
    int adjusted_images = map_->num_registered();
    int adjusted_points = map_->num_points();
    while (true) {
      int image = RegisterNext();
      const bool settled = adjusted_images == map_->num_registered() && adjusted_points == -1;
      if (image < 0 && settled && !map_->rolling()) image = RegisterByPair();
      if (image < 0) {
        // Everything adjusted, more may fit; else it is over.
        if (map_->num_registered() == map_->num_images() || settled) break;
        AdjustAll();
        adjusted_images = map_->num_registered();
        adjusted_points = -1;
        tried_at_.assign(images_.size(), -1);
        continue;
      }
      map_->Complete(image);
      map_->Filter(options_.max_error, map_->AdjustLocally(image));
      ReportProgress("image");
      if (map_->num_registered() > options_.global_growth * adjusted_images ||
          map_->num_points() >
              kPointGrowth * options_.global_growth * std::max(adjusted_points, 1)) {
        AdjustAll();
        adjusted_images = map_->num_registered();
        adjusted_points = map_->num_points();
      }
    }
  }

  // The next image by P3P; -1 if none can be registered now.
  int RegisterNext() {
    struct Candidate {
      double score;
      int image, count;
    };
    std::vector<Candidate> candidates;
    for (int image = 0; image < map_->num_images(); ++image) {
      if (map_->registered(image)) continue;
      int count = 0;
      const double score = map_->VisibleScore(image, &count);
      if (count < options_.min_inliers || count < kRetryGrowth * tried_at_[image]) continue;
      candidates.push_back({score, image, count});
    }
    std::stable_sort(candidates.begin(), candidates.end(),
                     [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
    for (const Candidate& candidate : candidates) {
      tried_at_[candidate.image] = candidate.count;
      const SceneMap::Visible visible = map_->VisiblePoints(candidate.image);
      AbsolutePoseOptions options;
      options.max_error =
          map_->rolling() ? wanted_.rolling_error * wanted_.max_error : wanted_.max_error;
      options.seed = options_.seed + static_cast<std::uint64_t>(candidate.image);
      const AbsolutePose found = EstimateAbsolutePose(visible.bearings, visible.points, options);
      const auto seen = static_cast<double>(visible.points.size());
      if (found.num_inliers < options_.min_inliers ||
          found.num_inliers < kFewestInlierShare * seen) {
        continue;
      }
      map_->Register(candidate.image, found.camera_from_world);
      if (map_->rolling()) map_->AdjustImage(candidate.image, options.max_error);
      return candidate.image;
    }
    return -1;
  }

  // The image whose pair with a registered one has most matches, see kPairMatches; -1: none.
  int RegisterByPair() {
    std::vector<const VerifiedPair*> open;
    for (const VerifiedPair& pair : pairs_) {
      const bool one = map_->registered(pair.first) != map_->registered(pair.second);
      if (one && static_cast<int>(pair.matches.size()) >= kPairMatches) open.push_back(&pair);
    }
    std::stable_sort(open.begin(), open.end(), [](const VerifiedPair* a, const VerifiedPair* b) {
      return a->matches.size() > b->matches.size();
    });
    for (const VerifiedPair* pair : open) {
      const bool forward = map_->registered(pair->first);
      const int image = forward ? pair->second : pair->first;
      if (by_pair_[image] != 0) continue;  // it did not hold, or is there
      const Pose found = RelativeNow(*pair);
      const Pose relative = forward ? found : found.Inverse();
      const Pose& other = map_->pose(forward ? pair->first : pair->second);
      const std::optional<double> length = LengthOf(relative, other, map_->VisiblePoints(image));
      if (!length) continue;
      by_pair_[image] = 1;
      map_->Register(image, Pose{relative.rotation, *length * relative.translation} * other);
      return image;
    }
    return -1;
  }

  // second_from_first through the lenses as they are now: pairs may have been verified by rough
  // ones.
  Pose RelativeNow(const VerifiedPair& pair) const {
    std::vector<Bearing> first, second;
    for (const auto& [one, other] : pair.matches) {
      first.push_back(map_->bearing(pair.first, one));
      second.push_back(map_->bearing(pair.second, other));
    }
    RelativePoseOptions options;
    options.max_error = wanted_.max_error;
    options.seed = options_.seed;
    const RelativePose found = EstimateRelativePose(first, second, options);
    return found.found ? found.second_from_first : pair.second_from_first;
  }

  // How long the translation of `relative` is: that with which most points are where they are seen.
  std::optional<double> LengthOf(const Pose& relative, const Pose& other,
                                 const SceneMap::Visible& visible) const {
    const std::size_t count = visible.points.size();
    std::vector<Eigen::Vector3d> turned(count);
    for (std::size_t i = 0; i < count; ++i) {
      turned[i] = relative.rotation * (other.rotation * visible.points[i] + other.translation);
    }
    const double max_error = kPairError * wanted_.max_error;
    int most = 0;
    double best = 0.0;
    for (std::size_t i = 0; i < count; ++i) {
      // (turned + length translation) x ray = 0
      const Eigen::Vector3d& ray = visible.bearings[i].ray;
      const Eigen::Vector3d moved = relative.translation.cross(ray);
      const double length = -turned[i].cross(ray).dot(moved) / moved.squaredNorm();
      if (!(length > 0.0)) continue;
      int agreeing = 0;
      for (std::size_t k = 0; k < count; ++k) {
        const Eigen::Vector3d point = turned[k] + length * relative.translation;
        agreeing += BearingResidual(visible.bearings[k], point).norm() < max_error ? 1 : 0;
      }
      if (agreeing > most) {
        most = agreeing;
        best = length;
      }
    }
    const double fewest = std::max<double>(kPairPoints, kPairShare * static_cast<double>(count));
    return most >= fewest ? std::optional(best) : std::nullopt;
  }

  void AdjustAll() {
    const bool lens_free = !options_.lens_free.empty() && !options_.lens_settled &&
                           map_->num_registered() >= kLensImages;
    map_->AdjustGlobally(kGlobalIterations, kGlobalTolerance, lens_free, lens_free, true);
    map_->Filter(options_.max_error);
    map_->Complete(-1);
    ReportProgress("adjustment");
  }

  Structure Finish() {
    const bool lens_free = !options_.lens_free.empty();
    int observations = 1;
    for (int factor = kGrowingError / 2; map_->rolling() && factor > 1; factor /= 2) {
      SetErrorFactor(factor);
      map_->Complete(-1);
      map_->AdjustGlobally(kFinalIterations, kGlobalTolerance, lens_free, lens_free, true);
      map_->Filter(options_.max_error);
    }
    SetErrorFactor(1.0);
    const bool extends = wanted_.extend_rounds > 0 && HasDescriptors(images_);
    for (int round = 0; round < kFinalRounds; ++round) {
      map_->AdjustGlobally(kFinalIterations, extends ? kExtendTolerance : kFinalTolerance,
                           lens_free, lens_free, true);
      const int dropped = map_->Filter(options_.max_error);
      const int added = map_->Complete(-1);
      map_->DropWeakImages();
      observations = std::max(1, map_->num_points());
      ReportProgress("settling");
      if (dropped + added < kSettled * observations) break;
    }
    for (int round = 0; extends && round < wanted_.extend_rounds; ++round) {
      map_->Extend();
      ReportProgress("longer tracks");
      map_->AdjustGlobally(kFinalIterations, kExtendTolerance, lens_free, lens_free, true);
      map_->Filter(options_.max_error);
      map_->Complete(-1);
      map_->DropWeakImages();
    }
    map_->AdjustFinally(kFinalIterations, kFinalTolerance, lens_free);
    map_->Filter(options_.max_error);
    map_->DropWeakImages();
    ReportProgress("final adjustment");
    Structure result = map_->Result(options_.covariances);
    ReportProgress("covariances");
    return result;
  }

  void ReportProgress(const char* step) const {
    if (!on_progress_) return;
    const StructureProgress progress = {map_->num_registered(), map_->num_images(),
                                        map_->num_points(), step};
    if (!on_progress_(progress)) throw SolveError("stopped");
  }

  const std::vector<Camera>& cameras_;
  const std::vector<ImageFeatures>& images_;
  std::span<const VerifiedPair> pairs_;
  const StructureOptions& wanted_;
  StructureOptions options_;  // with the largest error for now; read by the map too
  const std::function<bool(const StructureProgress&)>& on_progress_;
  std::unique_ptr<SceneMap> map_;
  std::vector<int> tried_at_;          // points an image saw when it was last tried
  std::vector<std::uint8_t> by_pair_;  // whether an image was placed by a pair
};

}  // namespace

bool HasDescriptors(const std::vector<ImageFeatures>& images) {
  return std::all_of(images.begin(), images.end(), [](const ImageFeatures& image) {
    return image.descriptors != nullptr || image.pixels.empty();
  });
}

Structure EstimatePoses(const std::vector<Camera>& cameras,
                        const std::vector<ImageFeatures>& images,
                        std::span<const VerifiedPair> pairs, const StructureOptions& options,
                        const std::function<bool(const StructureProgress&)>& on_progress) {
  CheckStructure(cameras, images, options);
  if (!options.rig.body_of_image.empty()) {
    throw InputError("a rig needs poses to begin with: see RefineStructure");
  }
  return Mapper(cameras, images, pairs, options, on_progress).Run();
}

}  // namespace gsut
