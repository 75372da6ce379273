// Structure from motion: poses of all photographs, and points, from verified matches.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "gsut/cameras/camera.h"
#include "gsut/geometry/camera_chain.h"
#include "gsut/geometry/pose.h"
#include "gsut/geometry/shutter.h"
#include "gsut/sfm/bundle.h"
#include "gsut/sfm/tracks.h"

namespace gsut {

struct ImageFeatures {
  int camera = 0;                       // into the cameras
  std::vector<Eigen::Vector2d> pixels;  // (0.5, 0.5) is the centre of the top-left pixel
  // (N, kDescriptorLength) of any length; kept by the caller. Null: tracks are not extended.
  const std::uint8_t* descriptors = nullptr;
  // Features of another kind, found less exactly or more so; empty: all are of one kind.
  std::vector<std::uint8_t> is_other = {};
};

// Cameras that are fixed to each other: what is known of them. Of an image the body (the rig in one
// frame) that its camera is on, from 0 without gaps, and the camera's mount on it (-1: the camera
// is the body). Empty: each image has a pose of its own.
struct Rig {
  std::vector<int> body_of_image, mount_of_image;
  std::vector<Pose> camera_from_body;  // of the mounts
  // Mounts are adjusted; the rig keeps its size (RMS distance of the cameras from their middle),
  // which sets the scale.
  bool refine = false;
};

// Of the points that an image sees, those that must agree with its pose.
inline constexpr double kFewestInlierShare = 0.2;

// A point whose place is known, as a survey states it.
struct StatedPoint {
  TrackElement seen;            // one of the features that show it
  Eigen::Vector3d mean, sigma;  // in the world of the given poses
};

struct StructureOptions {
  double max_error = 4.0;      // pixels: an observation farther off is an outlier
  double min_angle = 0.026;    // radians (1.5 degrees): smallest angle of a triangulated point
  int min_inliers = 15;        // points that a photograph must see to be registered
  double loss_scale = 1.5;     // of Cauchy's loss, in medians of the residuals' lengths
  double global_growth = 1.2;  // everything is adjusted when images or points grew by this
  int local_images = 6;        // adjusted when one is registered, with those that see the most
                               // of its points
  int initial_trials = 10;     // pairs tried as the first one
  // Share of the images with matches; with fewer, it starts from another pair.
  double enough_registered = 0.6;
  int most_restarts = 3;
  // Parameters of each camera that are estimated too, one flag each (empty: none), see
  // lens_parameters.h.
  std::vector<std::vector<std::uint8_t>> lens_free;
  // What is known of them beforehand, one prior a camera; empty: nothing. Of the first parameter,
  // a focal length, the median and the standard deviation of the logarithm.
  std::vector<LensPrior> lens_priors;
  // They are nearly right: it is enough to estimate them at the end. So are the poses given to
  // RefineStructure, which then needs no looser rounds.
  bool lens_settled = false;
  // Rolling shutters: how lines are read; each image then has a velocity of its own. rolling_error:
  // the largest error, in units of max_error, until velocities are known.
  Shutter shutter;
  double rolling_error = 12.0;
  // Where cameras differ: how each image is read (global: at once), and how long, over the readout
  // that velocities are for; middles coincide. Empty: as `shutter` says, and as long.
  std::vector<Shutter> image_shutters;
  std::vector<double> image_readouts;
  double ReadoutOf(int image) const { return image_readouts.empty() ? 1.0 : image_readouts[image]; }
  // When each image was taken, and the readout in units of that time: velocities are then held near
  // those between an image's neighbours, of the same camera where `frame_cameras` names it. Empty
  // or 0: unknown.
  std::vector<double> frame_times;
  std::vector<int> frame_cameras;
  double readout_time = 0.0;
  // Where it is known otherwise: the velocity of each image for a unit of that time
  // (camera_chain.h; of a rig the body's, the same for all images of one; not finite: not known),
  // instead of that between its neighbours; to this share of itself, 0: exactly.
  std::vector<Velocity> image_rates;
  double rate_sigma = 0.1;
  bool KnowsVelocity(int image) const {
    return readout_time > 0 && !image_rates.empty() && image_rates[image].allFinite();
  }
  // That velocity for a readout; none where it is not known.
  Velocity KnownVelocity(int image) const {
    return KnowsVelocity(image) ? Velocity(readout_time * image_rates[image]) : Velocity::Zero();
  }
  // Where cameras stood, in the world of the given poses (not finite: not known), to this standard
  // deviation a coordinate; for RefineStructure, of a rig with mounts that stay; the first image of
  // a body stands for it. Empty: not known.
  std::vector<Eigen::Vector3d> places;
  Eigen::Vector3d place_sigma = Eigen::Vector3d::Ones();
  // Points whose place is known, for RefineStructure without a rig; fewer than three have no
  // weight.
  std::vector<StatedPoint> stated_points;
  // Turns between images as a gyroscope measured them (bundle.h), for RefineStructure without a
  // rig, and the standard deviations of their calibration. Empty: not known.
  std::vector<TurnPrior> turns;
  Eigen::VectorXd calibration_sigma;
  // At the end points are looked for in images that do not see them yet: features within this many
  // pixels of their projection whose descriptor, of unit length, is no farther than that from the
  // points' own. Rounds of it; 0: none.
  double extend_radius = 5.0;
  double extend_distance = 0.8;
  int extend_rounds = 0;
  // From this number of registered images on, all adjustments but the last leave out tracks that no
  // image needs, and the last one starts where such an adjustment has ended. Not on a rig.
  int thin_from = 64;
  Rig rig;  // for RefineStructure
  bool covariances = true;
  std::uint64_t seed = 0;
};

struct StructurePoint {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // in the world
  std::vector<TrackElement> observations;              // that agree with it
  std::vector<Eigen::Vector3d> in_camera;  // the point in the camera of each observation
  double error = 0.0;                      // pixels: mean length of their residuals
};

struct Structure {
  Structure() = default;
  // Of no image, and why.
  Structure(std::vector<Camera> cameras_in, std::size_t images, std::string failure_in)
      : cameras(std::move(cameras_in)),
        registered(images, 0),
        camera_from_world(images),
        covariances(images, Eigen::Matrix<double, 6, 6>::Zero()),
        failure(std::move(failure_in)) {}

  std::vector<Camera> cameras;
  std::vector<std::uint8_t> registered;  // one an image
  std::vector<Pose> camera_from_world;   // identity where not registered
  // Of rolling shutters, else empty: of each image's own camera for its own readout, see
  // camera_chain.h.
  std::vector<Velocity> velocities;
  std::vector<Pose> camera_from_body;  // of a rig's mounts, see Rig::refine
  std::vector<StructurePoint> points;
  int initial_first = -1, initial_second = -1;
  int restarts = 0;
  double rms = 0.0;          // pixels: root of the mean squared length of the residuals
  double median = 0.0;       // pixels: median length
  double other_noise = 1.0;  // of features of another kind, over the first kind's
  // (6, 6) of (centre in the world, turn in the camera frame), see PoseCovariances; 0 where not
  // registered. The first image's pose and one component of the second's centre are held.
  std::vector<Eigen::Matrix<double, 6, 6>> covariances;
  std::string failure;  // why nothing was found; empty if something was
};

// Whether tracks can be extended: all images that have features have descriptors.
bool HasDescriptors(const std::vector<ImageFeatures>& images);

struct StructureProgress {
  int registered = 0, images = 0, points = 0;
  const char* step = "";  // what was just done
};

// Incremental: the pair with most parallax over many matches first, then one photograph after the
// other by P3P, new points along rays, local bundle adjustment, and everything at times; outliers
// are taken out and tracks completed in between. Starts again from another pair where it gets
// stuck early, and keeps the best. World: the first image's frame, the first baseline is 1 long.
// Args: pairs: verified matches; on_progress: called after each image, returns false to stop (then
//   SolveError is thrown); may be empty.
// Throws InputError for an index out of range.
Structure EstimatePoses(const std::vector<Camera>& cameras,
                        const std::vector<ImageFeatures>& images,
                        std::span<const VerifiedPair> pairs, const StructureOptions& options,
                        const std::function<bool(const StructureProgress&)>& on_progress);

}  // namespace gsut
