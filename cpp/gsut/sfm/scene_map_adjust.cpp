// Bundle adjustment of the growing structure, and the result.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/sfm/scene_map.h"

namespace gsut {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
// Cauchy's loss never bends below this many pixels.
constexpr double kLeastLoss = 0.02;
// Fewest tracks of each kind of features that show how exactly these are found.
constexpr std::size_t kFewestOfKind = 30;
// Fewest images whose velocities show how much all of them move.
constexpr std::size_t kFewestVelocities = 6;
// What they show at least and at most: cameras that stand still, and none that a hand holds
// (radians, and share of the distance to the points).
constexpr double kLeastSigma = 1e-4;
constexpr double kMostTurnSigma = 0.2;
constexpr double kMostShiftSigma = 0.1;
// Median of the squared length of three normal numbers of variance 1.
constexpr double kMedianSquare = 2.366;
// Pixels: features are not found more exactly, though few images with a velocity each may fit them.
constexpr double kFeatureNoise = 0.15;
// Uncertainty of a velocity taken from neighbours in time, as a share of itself.
constexpr double kNeighborSigma = 0.3;
// The same at least: radians, and share of the distance to the points. Of a velocity by flow, times
// its relative uncertainty.
constexpr double kLeastTurnSigma = 0.02;
constexpr double kLeastShiftSigma = 0.01;

// Median length of a normal vector in the plane, in standard deviations of a coordinate.
constexpr double kMedianLength = 1.1774;

double Median(std::vector<double>* values) {
  if (values->empty()) return 0.0;
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

// Of each image the median distance to the points that it sees.
std::vector<double> MedianDistances(const Bundle& bundle) {
  std::vector<std::vector<double>> distances(bundle.camera_from_world.size());
  for (const BundleObservation& o : bundle.observations) {
    distances[o.image].push_back(
        (bundle.points[o.point] - bundle.camera_from_world[o.image].CenterInSource()).norm());
  }
  std::vector<double> medians;
  for (std::vector<double>& own : distances) medians.push_back(Median(&own));
  return medians;
}

}  // namespace

// The loss follows the data: it bends at a multiple of the median residual, so that sharp features
// are weighed finely and blurred ones are not all outliers.
void SceneMap::UpdateLoss() {
  UpdateNoise();
  // Chunks find their lengths beside each other; a median has no order.
  const auto count = static_cast<std::int64_t>(tracks_.size());
  std::vector<std::vector<double>> parts((count + kTrackGrain - 1) / kTrackGrain);
  ParallelFor(count, kTrackGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t t = begin; t < end; ++t) {
      for (const Observation& observation : tracks_[t].observations) {
        if (!tracks_[t].has_point || !observation.used) continue;
        parts[begin / kTrackGrain].push_back(Residual(tracks_[t], observation) /
                                             NoiseOf(observation));
      }
    }
  });
  std::vector<double> lengths;
  for (const auto& part : parts) lengths.insert(lengths.end(), part.begin(), part.end());
  if (lengths.empty()) return;
  loss_pixels_ = std::clamp(options_.loss_scale * Median(&lengths), kLeastLoss,
                            std::max(kLeastLoss, options_.max_error / kErrorOverBend));
}

// The variance component of features of another kind. Of each track the residuals' squares over the
// median of a chi-squared variable of its degrees of freedom (Wilson and Hilferty, 1931) estimate a
// variance; the median over the tracks of a kind is not moved by wrong matches.
void SceneMap::UpdateNoise() {
  if (std::ranges::all_of(images_, [](const auto& image) { return image.is_other.empty(); }))
    return;
  std::array<std::vector<double>, 2> variances;
  for (const Track& track : tracks_) {
    if (!track.has_point) continue;
    double squares = 0.0;
    int used = 0;
    bool is_other = false;
    for (const Observation& observation : track.observations) {
      if (!observation.used) continue;
      const double length = Residual(track, observation);
      squares += length * length;
      ++used;
      is_other = IsOther(observation);
    }
    const double freedom = 2.0 * used - 3.0;
    variances[is_other].push_back(squares / (freedom * std::pow(1 - 2 / (9 * freedom), 3)));
  }
  if (std::min(variances[0].size(), variances[1].size()) < kFewestOfKind) return;
  const auto sigma = [](std::vector<double>* squares) {
    return std::max(std::sqrt(Median(squares)), kLeastLoss);
  };
  other_noise_ = sigma(&variances[1]) / sigma(&variances[0]);
}

// A new image changes what is near it: itself and the images that share most points with it move,
// which costs the same however large the structure has become.
std::vector<int> SceneMap::AdjustLocally(int image) {
  std::vector<int> shared(images_.size(), 0);
  for (const int index : tracks_of_image_[image]) {
    const Track& track = tracks_[index];
    if (!track.has_point) continue;
    for (const Observation& seen_by : track.observations) shared[seen_by.image] += seen_by.used;
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
  constexpr int kLocalIterations = 8;
  constexpr double kLocalTolerance = 1e-4;  // relative; the next image moves them again
  options.max_iterations = kLocalIterations;
  options.function_tolerance = kLocalTolerance;
  std::vector<int> image_of;
  std::vector<int> tracks = TracksOf(&free);
  Bundle bundle = MakeBundle(&free, tracks, &options, &image_of);
  AdjustBundle(&bundle, options);
  StoreBundle(bundle, image_of, tracks);
  return tracks;
}

void SceneMap::AdjustGlobally(int max_iterations, double tolerance, bool through_lens,
                              bool lens_free, bool thin) {
  BundleOptions options;
  options.max_iterations = max_iterations;
  options.function_tolerance = tolerance;
  options.through_lens = through_lens || lens_free;
  if (lens_free) options.lens_free = options_.lens_free;
  std::vector<int> image_of;
  const bool some = thin && ThinsOut();
  const std::vector<int> tracks = some ? ChooseSpread() : TracksOf(nullptr);
  Bundle bundle = MakeBundle(nullptr, tracks, &options, &image_of);
  AdjustBundle(&bundle, options);
  const std::vector<Pose> before = poses_;
  StoreBundle(bundle, image_of, tracks);
  if (rolling() && !HasRates()) UpdateVelocitySigmas(bundle);
  if (lens_free) {
    cameras_ = bundle.cameras;
    UpdateBearings();
  }
  if (some) PlaceOthers(tracks, before);
  UpdateLoss();
}

// The nearest registered image of the camera on either side in time; at an end, the image itself is
// one of them.
Velocity SceneMap::NeighborVelocity(int image) const {
  int before = image, after = image;
  const std::vector<double>& times = options_.frame_times;
  for (int other = 0; other < num_images(); ++other) {
    const std::vector<int>& cameras = options_.frame_cameras;
    const bool of_another = !cameras.empty() && cameras[other] != cameras[image];
    if (!registered_[other] || of_another) continue;
    const bool earlier = times[other] < times[image];
    const bool later = times[other] > times[image];
    if (earlier && (before == image || times[other] > times[before])) before = other;
    if (later && (after == image || times[other] < times[after])) after = other;
  }
  if (before == after) return Velocity::Constant(kNaN);
  return VelocityBetween(poses_[before], poses_[after]) / (times[after] - times[before]);
}

// Empirical Bayes: velocities that all err alike bend the scene at little cost, and a prior that is
// wider than images move lets them. It narrows to what their velocities show.
void SceneMap::UpdateVelocitySigmas(const Bundle& bundle) {
  if (bundle.velocities.size() < kFewestVelocities) return;
  const std::vector<double> distances = MedianDistances(bundle);
  std::vector<double> shifts, turns;
  for (std::size_t i = 0; i < distances.size(); ++i) {
    const Velocity& velocity = bundle.velocities[i];
    turns.push_back(velocity.tail<3>().squaredNorm());
    if (distances[i] > 0) {
      shifts.push_back(velocity.head<3>().squaredNorm() / (distances[i] * distances[i]));
    }
  }
  const auto sigma = [](std::vector<double>* squares, double most) {
    return std::clamp(std::sqrt(Median(squares) / kMedianSquare), kLeastSigma, most);
  };
  turn_sigma_ = sigma(&turns, kMostTurnSigma);
  shift_sigma_ = sigma(&shifts, kMostShiftSigma);
}

// A rolling shutter's velocity and the pose explain much of the same, so velocities need priors:
// near what flow, or neighbours in time, say of them; else near standing still, as far as all
// images move.
void SceneMap::SetPriors(const Bundle& bundle, const std::vector<int>& image_of,
                         BundleOptions* options) const {
  const std::vector<double> distances = MedianDistances(bundle);
  options->noise = HasRates() ? loss_pixels_ : std::max(loss_pixels_, kFeatureNoise);
  for (std::size_t i = 0; i < image_of.size(); ++i) {
    VelocityPrior prior;
    prior.sigma.head<3>().setConstant(shift_sigma_ * distances[i]);
    prior.sigma.tail<3>().setConstant(turn_sigma_);
    const int image = image_of[i];
    if (HasRates()) {
      const bool flow = !options_.image_rates.empty();
      const Velocity mean =
          options_.readout_time * (flow ? options_.image_rates[image] : NeighborVelocity(image));
      if (mean.allFinite()) {
        const double share = flow ? options_.rate_sigma : kNeighborSigma;
        const double least = flow ? options_.rate_sigma : 1.0;
        prior.mean = mean;
        prior.sigma.head<3>().setConstant(least * kLeastShiftSigma * distances[i] +
                                          share * mean.head<3>().norm());
        prior.sigma.tail<3>().setConstant(least * kLeastTurnSigma + share * mean.tail<3>().norm());
      }
    }
    options->velocity_priors.push_back(prior);
    options->velocity_fixed.push_back(hold_velocities_ && options_.KnowsVelocity(image));
  }
}

// Priors that are known by measurement are weighed against the features' own noise. Velocities
// and mounts have set a larger one, with which their standard deviations go.
double SceneMap::ScaleOfSigmas(BundleOptions* options) const {
  const double noise = loss_pixels_ / (options_.loss_scale * kMedianLength);
  const bool is_set = !options->velocity_priors.empty() || !options->mount_priors.empty();
  if (!is_set) options->noise = noise;
  return options->noise / noise;
}

// Places fix the gauge.
void SceneMap::SetPlacePriors(const std::vector<int>& image_of, BundleOptions* options) const {
  options->gauge_image = options->scale_image = -1;
  const double scale = ScaleOfSigmas(options);
  for (const int image : image_of) {
    PlacePrior& prior = options->place_priors.emplace_back();
    if (!options_.places[image].allFinite()) continue;
    prior = {options_.places[image], scale * options_.place_sigma};
  }
}

void SceneMap::SetTurnPriors(const std::vector<int>& place, BundleOptions* options) const {
  const double scale = ScaleOfSigmas(options);
  options->calibration_sigma = scale * options_.calibration_sigma;
  for (TurnPrior turn : options_.turns) {
    turn.first = place[turn.first];
    turn.second = place[turn.second];
    if (turn.first < 0 || turn.second < 0) continue;
    turn.sigma *= scale;
    options->turn_priors.push_back(std::move(turn));
  }
}

// The logarithm of a focal length is known, which is as good as linear near where it is.
void SceneMap::SetLensPriors(BundleOptions* options) const {
  const double scale = ScaleOfSigmas(options);
  options->lens_priors = options_.lens_priors;
  for (std::size_t c = 0; c < options->lens_priors.size(); ++c) {
    LensPrior& prior = options->lens_priors[c];
    if (prior.sigma.empty()) continue;
    if (std::isfinite(prior.sigma[0])) {
      const double focal = cameras_[c].params()[0];
      prior.mean[0] = focal * (1.0 - std::log(focal / prior.mean[0]));
      prior.sigma[0] *= focal;
      if (std::isfinite(prior.sigma[1])) prior.mean[1] = prior.mean[0];  // a difference
    }
    for (double& sigma : prior.sigma) sigma *= scale;
  }
}

void SceneMap::AdjustImage(int image, double max_error) {
  // More than once: observations that looked wrong for a still camera may be right after all.
  constexpr int kRounds = 3;       // the choice of observations settles in two
  constexpr int kIterations = 20;  // twelve unknowns converge in fewer
  for (int round = 0; round < kRounds; ++round) {
    Bundle bundle;
    BundleOptions options;
    bundle.cameras = {cameras_[images_[image].camera]};
    bundle.camera_of_image = {0};
    bundle.camera_from_world = {poses_[image]};
    if (rolling()) bundle.velocities = {velocities_[image]};
    for (const int index : tracks_of_image_[image]) {
      const Track& track = tracks_[index];
      if (!track.has_point) continue;
      for (const Observation& observation : track.observations) {
        if (observation.image != image || !HasRay(observation)) continue;
        if (!(Residual(track, observation) < max_error)) continue;
        bundle.observations.push_back({0, static_cast<int>(bundle.points.size()),
                                       bearings_[image][observation.feature],
                                       images_[image].pixels[observation.feature],
                                       TimeOf(observation), NoiseOf(observation)});
        bundle.points.push_back(track.position);
      }
    }
    // Points are held: only the image moves.
    if (bundle.points.empty()) return;
    options.point_fixed.assign(bundle.points.size(), 1);
    options.loss_scale = max_error / kErrorOverBend;
    options.max_iterations = kIterations;
    if (rolling()) SetPriors(bundle, {image}, &options);
    options.noise = options.loss_scale;
    AdjustBundle(&bundle, options);
    StoreBundle(bundle, {image}, {});
    max_error = std::max(options_.max_error, max_error / kErrorOverBend);
  }
}

// Residuals of observations that were used go into the RMS and median.
Structure SceneMap::Result(bool covariances) const {
  Structure result;
  result.cameras = cameras_;
  result.registered = registered_;
  result.camera_from_body = camera_from_body_;
  result.camera_from_world.resize(images_.size());
  if (rolling()) result.velocities.assign(images_.size(), Velocity::Zero());
  for (int image = 0; image < num_images(); ++image) {
    if (!registered_[image]) continue;
    result.camera_from_world[image] = poses_[image];
    if (rolling()) result.velocities[image] = VelocityOf(image);
  }
  std::vector<double> lengths;
  for (const Track& track : tracks_) {
    if (!track.has_point) continue;
    StructurePoint point;
    point.position = track.position;
    for (const Observation& observation : track.observations) {
      if (!observation.used) continue;
      const double length = Residual(track, observation);
      lengths.push_back(length);
      point.error += length;
      point.observations.push_back({observation.image, observation.feature});
      const Pose& pose = PoseOf(observation);
      point.in_camera.emplace_back(pose.rotation * track.position + pose.translation);
    }
    point.error /= static_cast<double>(std::max<std::size_t>(1, point.observations.size()));
    result.points.push_back(std::move(point));
  }
  for (const double length : lengths) result.rms += length * length;
  if (!lengths.empty()) result.rms = std::sqrt(result.rms / static_cast<double>(lengths.size()));
  result.median = Median(&lengths);
  result.other_noise = other_noise_;
  result.covariances.assign(images_.size(), Eigen::Matrix<double, 6, 6>::Zero());
  if (covariances && num_registered_ >= 2) {
    BundleOptions options;
    std::vector<int> image_of;
    const Bundle bundle = MakeBundle(nullptr, TracksOf(nullptr), &options, &image_of);
    // Relative to the first image, as without places and points that are stated.
    const auto placed = [&](int image) {
      const auto found = std::find(image_of.begin(), image_of.end(), image);
      return found == image_of.end() ? -1 : static_cast<int>(found - image_of.begin());
    };
    if (!options.place_priors.empty() || !options.point_priors.empty()) {
      options.place_priors.clear();
      options.point_priors.clear();
      options.gauge_image = placed(gauge_first_);
      options.scale_image = placed(gauge_second_);
    }
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
