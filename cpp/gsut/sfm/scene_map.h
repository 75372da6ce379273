// The growing structure: which tracks have points, which observations agree, what to adjust.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "gsut/sfm/bearing.h"
#include "gsut/sfm/bundle.h"
#include "gsut/sfm/structure.h"
#include "gsut/sfm/triangulate.h"

namespace gsut {

// Tracks of a chunk of parallel work.
inline constexpr std::int64_t kTrackGrain = 256;

// Throws InputError for an index out of range, or a list whose length does not fit; says which.
void CheckStructure(const std::vector<Camera>& cameras, const std::vector<ImageFeatures>& images,
                    const StructureOptions& options);

class SceneMap {
 public:
  struct Observation {
    int image = 0;
    int feature = 0;
    bool used = false;  // agrees with the track's point
  };
  struct Track {
    std::vector<Observation> observations;
    Eigen::Vector3d position = Eigen::Vector3d::Zero();
    bool has_point = false;
  };

  // images are kept by reference.
  SceneMap(std::vector<Camera> cameras, const std::vector<ImageFeatures>& images,
           std::span<const VerifiedPair> pairs, const StructureOptions& options);

  int num_images() const { return static_cast<int>(images_.size()); }
  int num_registered() const { return num_registered_; }
  int num_points() const;
  bool registered(int image) const { return registered_[image] != 0; }
  const Pose& pose(int image) const { return poses_[image]; }
  // Whether images were read line by line, each line with its own pose.
  bool rolling() const { return !options_.shutter.IsGlobal(); }
  // Whether images share bodies, see Rig; their mounts as they are now.
  bool on_rig() const { return !options_.rig.body_of_image.empty(); }
  const std::vector<Pose>& camera_from_body() const { return camera_from_body_; }
  Pose CameraFromBody(int image) const;
  const std::vector<Track>& tracks() const { return tracks_; }
  const std::vector<Camera>& cameras() const { return cameras_; }
  const Bearing& bearing(int image, int feature) const { return bearings_[image][feature]; }

  // velocity: of a rolling shutter, see camera_chain.h; on a rig the body's.
  void Register(int image, const Pose& camera_from_world,
                const Velocity& velocity = Velocity::Zero());
  // The image and all others of its body, by the mounts.
  void RegisterBody(int image, const Pose& camera_from_world);
  // Forgets all poses and points.
  void Reset();

  // Observations of points by an image: bearings and positions, and the tracks that they belong to.
  struct Visible {
    std::vector<Bearing> bearings;
    std::vector<Eigen::Vector3d> points;
    std::vector<int> tracks;
  };
  Visible VisiblePoints(int image) const;
  // How many points an image sees and how evenly: occupied cells of finer and finer grids.
  double VisibleScore(int image, int* count) const;

  // New points, and new observations of old points, of the tracks that an image has (-1: of all).
  // Returns the number of observations that became used.
  int Complete(int image);
  // Looks for features where images should see points, see StructureOptions; joins what it finds,
  // and makes all points again. Returns the number of features found.
  int Extend();
  // Drops observations beyond the largest error and points without two good ones and the smallest
  // angle. Returns the number of observations dropped.
  int Filter(double max_error);
  // The same of these tracks alone.
  int Filter(double max_error, const std::vector<int>& tracks);

  // An image's pose, and velocity, from the points that it sees within this error (pixels), which
  // shrinks to the options'.
  void AdjustImage(int image, double max_error);
  // Bundle adjustment around an image with those that share most points with it. Returns the tracks
  // that took part.
  std::vector<int> AdjustLocally(int image);
  // Of everything. through_lens: see BundleOptions. Lenses are free where the options say so. thin:
  // of many images, only as many tracks as hold each; the other points follow.
  void AdjustGlobally(int max_iterations, double tolerance, bool through_lens, bool lens_free,
                      bool thin);
  // The last adjustment, through the lens and by all tracks.
  void AdjustFinally(int max_iterations, double tolerance, bool lens_free);
  // Whether adjustments may leave tracks out: there are enough images.
  bool ThinsOut() const;
  // Unregisters images, or bodies, that see too few points now; returns how many images.
  int DropWeakImages();

  // Velocities that are known otherwise (StructureOptions::image_rates) are not adjusted from now
  // on, or are again.
  void HoldVelocities(bool hold) { hold_velocities_ = hold; }
  void SetGauge(int first, int second) {
    gauge_first_ = first;
    gauge_second_ = second;
  }
  // The result, without `initial`, `restarts` and `failure`.
  Structure Result(bool covariances) const;

 private:
  // The largest error over the error where Cauchy's loss bends, at least: an observation about to
  // be dropped has lost most of its weight before, so that dropping it moves little.
  static constexpr double kErrorOverBend = 4.0;

  double Residual(const Track& track, const Observation& observation) const;
  bool HasRay(const Observation& observation) const {
    return has_ray_[observation.image][observation.feature] != 0;
  }
  // camera_from_world when the line of the observation is read, and that time.
  const Pose& PoseOf(const Observation& observation) const {
    return rolling() ? moved_[observation.image][observation.feature] : poses_[observation.image];
  }
  bool IsOther(const Observation& observation) const {
    const auto& others = images_[observation.image].is_other;
    return !others.empty() && others[observation.feature] != 0;
  }
  // In units of the noise of features of the first kind.
  double NoiseOf(const Observation& observation) const {
    return IsOther(observation) ? other_noise_ : 1.0;
  }
  double TimeOf(const Observation& observation) const {
    return rolling() ? times_[observation.image][observation.feature] : 0.0;
  }
  // Time of the line of an image that holds a pixel, -0.5 to 0.5 in units of the readout that
  // velocities are for; 0 for a global shutter.
  double TimeAt(const Eigen::Vector2d& pixel, int image) const;
  // camera_from_world of an image at such a time.
  Pose LinePose(int image, double time) const;
  // Of an image's own camera, for its own readout.
  Velocity VelocityOf(int image) const;
  void SetTracks(const std::vector<std::vector<TrackElement>>& tracks);
  // The cell of the finest grid of `VisibleScore` that holds a feature.
  int ScoreCell(const TrackElement& element) const;
  struct Candidate {
    int track = 0, feature = 0;
    float squared = 0.0F;  // distance of the descriptors
  };
  // Features of an image that may be points it does not see yet.
  std::vector<Candidate> CandidatesIn(int image, const Eigen::MatrixXf& descriptors) const;
  void Place(int image, const Pose& camera_from_world, const Velocity& velocity);
  // Whether flow, or neighbours in time, say how each image moves.
  bool HasRates() const {
    return options_.readout_time > 0 &&
           !(options_.frame_times.empty() && options_.image_rates.empty());
  }
  // From the registered images before and after, for a unit of time; NaN if there are none.
  Velocity NeighborVelocity(int image) const;
  double ScaleOfSigmas(BundleOptions* options) const;
  void SetLensPriors(BundleOptions* options) const;
  void SetPlacePriors(const std::vector<int>& image_of, BundleOptions* options) const;
  // Of each stated point the track, -1: none has its feature.
  std::vector<int> StatedTracks() const;
  // tracks: of the bundle's points, in order.
  void SetPointPriors(const std::vector<int>& tracks, BundleOptions* options) const;
  // place: of each image in the bundle, -1: it has none.
  void SetTurnPriors(const std::vector<int>& place, BundleOptions* options) const;
  void SetPriors(const Bundle& bundle, const std::vector<int>& image_of,
                 BundleOptions* options) const;
  // How much images move during their readout, by their velocities; of an adjustment of everything.
  void UpdateVelocitySigmas(const Bundle& bundle);
  int CompleteTrack(Track* track);
  void UpdateBearings();
  void UpdateLoss();
  void UpdateNoise();
  std::vector<int> TracksOf(const std::vector<std::uint8_t>* images_free) const;
  std::vector<int> ChooseSpread() const;
  void PlaceOthers(const std::vector<int>& adjusted, const std::vector<Pose>& before);
  Bundle MakeBundle(const std::vector<std::uint8_t>* images_free, const std::vector<int>& tracks,
                    BundleOptions* options, std::vector<int>* image_of) const;
  void AddImage(int image, Bundle* bundle, std::vector<int>* image_of) const;
  // Adds the rig, and the images of its bodies that see nothing; sets the gauge.
  void AddRig(Bundle* bundle, BundleOptions* options, std::vector<int>* image_of) const;
  // Gives a rig whose mounts were adjusted its size back, and the world the scale that goes with
  // it.
  void RestoreRigSize(const Bundle& bundle);
  void StoreBundle(const Bundle& bundle, const std::vector<int>& image_of,
                   const std::vector<int>& tracks);

  std::vector<Camera> cameras_;
  const std::vector<ImageFeatures>& images_;
  const StructureOptions& options_;
  std::vector<std::vector<Bearing>> bearings_;
  std::vector<std::vector<std::uint8_t>> has_ray_;
  std::vector<int> num_features_;
  std::vector<Track> tracks_;
  // Of each image its tracks, and where it sees each: a cell of the finest grid of `VisibleScore`.
  std::vector<std::vector<int>> tracks_of_image_, cells_of_image_;
  std::vector<std::uint8_t> registered_;
  std::vector<Pose> poses_;  // in the middle of the readout
  std::vector<Pose> camera_from_body_;
  // Of rolling shutters, else empty: per image the velocity, on a rig the body's; per feature the
  // time of its line (-0.5 to 0.5) and camera_from_world then.
  std::vector<Velocity> velocities_;
  std::vector<std::vector<double>> times_;
  std::vector<std::vector<Pose>> moved_;
  bool hold_velocities_ = false;
  // Standard deviations, a component, of what images turn (radians) and move (of the distance to
  // their points) during their readout, where nothing is known of each; first a hand in haste.
  double turn_sigma_ = 0.05, shift_sigma_ = 0.05;
  int num_registered_ = 0;
  double loss_pixels_;        // where Cauchy's loss bends now
  double other_noise_ = 1.0;  // of features of another kind, over the first kind's
  int gauge_first_ = -1, gauge_second_ = -1;
};

// Bodies whose images have no pose get one, and all their images, where enough points agree: P3P on
// what one image sees begins, then what all images of the body see decides. A few points in each
// camera are enough, where each alone would be too few.
// Args: options: max_error, min_inliers and seed; map: on a rig.
// Returns the number of images that were registered.
int PlaceBodies(const StructureOptions& options, SceneMap* map);

}  // namespace gsut
