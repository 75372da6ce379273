// Bundle adjustment: refines poses, points and optionally lenses from where features were seen.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <string>
#include <vector>

#include "gsut/cameras/camera.h"
#include "gsut/sfm/bearing.h"
#include "gsut/geometry/camera_chain.h"
#include "gsut/geometry/pose.h"

namespace gsut {

struct BundleObservation {
  int image = 0;
  int point = 0;
  Bearing bearing;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  double time = 0.0;   // of its line in a rolling shutter's readout, -0.5 to 0.5
  double noise = 1.0;  // in units of an ordinary observation's: its residual is divided by it
};

// What is adjusted. Cameras are shared by any number of images.
struct Bundle {
  std::vector<Camera> cameras;
  std::vector<int> camera_of_image;
  std::vector<Pose> camera_from_world;  // in the middle of the readout
  std::vector<Eigen::Vector3d> points;
  std::vector<BundleObservation> observations;
  // Of rolling shutters: how the image's body moves, one an image; empty: all stand still.
  std::vector<Velocity> velocities;
  // Of rigs: the body that an image's camera is on, the mount on it (-1: the camera is the body),
  // and camera_from_body of the mounts. Empty: each image is its own body. A body's pose is taken
  // from its first image; the others' poses follow from it.
  std::vector<int> body_of_image;
  std::vector<int> mount_of_image;
  std::vector<Pose> camera_from_body;
};

// What is known of a velocity beforehand: its mean and standard deviation, component by component;
// infinite: nothing.
struct VelocityPrior {
  Velocity mean = Velocity::Zero();
  Velocity sigma = Velocity::Constant(std::numeric_limits<double>::infinity());
};

// What is known of a lens beforehand: mean and standard deviation of each parameter (infinite:
// nothing); none of either: nothing is known. Of tied parameters the first one's holds, and of one
// that is near them (see lens_parameters.h) that of its own amount.
struct LensPrior {
  std::vector<double> mean, sigma;
};

// Where a camera stood as something other than images states it: infinite: nothing is known.
struct PlacePrior {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();  // its centre, in the world
  Eigen::Vector3d sigma = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
};

// How one camera is turned against another as a gyroscope measured it, with what its calibration
// (bias, scale ...) changes: rotation <- exp(by_calibration c) rotation, c unknown.
struct TurnPrior {
  int first = 0, second = 0;                               // images
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();  // second_from_first
  Eigen::Matrix3Xd by_calibration;                         // one column an unknown
  double sigma = 1.0;                                      // radians, of each component
};

// Where a point lies as something other than images states it, in the world.
struct PointPrior {
  int point = 0;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), sigma = Eigen::Vector3d::Ones();
};

struct BundleOptions {
  // False: the residual of Bearing (valid to 180 degrees, no lens in the loop). True: the pixel of
  // the point through the lens minus the pixel seen; where a point has left the lens' domain, the
  // residual of Bearing stands in, so that leaving never lowers the cost.
  bool through_lens = false;
  double loss_scale = 1.0;  // pixels: Cauchy's loss beyond about this; 0: plain squares
  int max_iterations = 50;
  double function_tolerance = 1e-6;  // relative decrease of the cost at which it stops
  // Images and points that stay as they are; empty: none.
  std::vector<std::uint8_t> image_fixed;
  std::vector<std::uint8_t> point_fixed;
  // Without a fixed image, the gauge is held by gauge_image (its whole pose) and scale_image (that
  // component of its centre which is farthest from the other's). -1: not held.
  int gauge_image = -1;
  int scale_image = -1;
  // lens_free[c]: which parameters of camera c are estimated, one flag each (see
  // lens_parameters.h: equal flags above 1 are tied); empty: none. Needs
  // through_lens.
  std::vector<std::vector<std::uint8_t>> lens_free;
  // What is known of free parameters beforehand, one prior a camera; empty: nothing.
  std::vector<LensPrior> lens_priors;
  // Velocities are adjusted, if the bundle has them, where their image is not fixed; held by priors
  // (one an image; empty: none).
  std::vector<VelocityPrior> velocity_priors;
  std::vector<std::uint8_t> velocity_fixed;  // images whose velocity stays; empty: none
  // Centres are held near stated places (one an image; empty: none; a rig's first image stands for
  // its body). They fix the gauge, which no image then needs to hold.
  std::vector<PlacePrior> place_priors;
  // Points that are held near stated places, each once. Three of them fix the gauge, which no image
  // then needs to hold. PoseCovariances leaves them out.
  std::vector<PointPrior> point_priors;
  // Turns between images that no rig holds, and the standard deviations of their calibration, which
  // is estimated too and not returned. PoseCovariances leaves them out: its result is an upper
  // bound.
  std::vector<TurnPrior> turn_priors;
  Eigen::VectorXd calibration_sigma;
  double noise = 1.0;  // of observations in pixels a coordinate, against which priors are weighed
  // Which mounts are adjusted, one flag each; empty: none. Where the scale is held by an image, it
  // is the mounts' length that follows.
  std::vector<std::uint8_t> mount_free;
  // What is known of the mounts beforehand: a pose each (empty: nothing), and the standard
  // deviation of a centre and of a turn in radians, against the noise above.
  std::vector<Pose> mount_priors;
  double mount_center_sigma = std::numeric_limits<double>::infinity();
  double mount_turn_sigma = std::numeric_limits<double>::infinity();
};

struct BundleSummary {
  double cost_before = 0.0, cost_after = 0.0;  // half the squares under the loss, with priors
  int iterations = 0;
  bool converged = false;
  double fill = 0.0;  // share of the system reduced to images that was not zero: 1 is a dense one
};

// Levenberg-Marquardt; changes the bundle in place, to the same bits on any number of threads.
// Throws InputError for an index out of range, SolveError if it fails.
BundleSummary AdjustBundle(Bundle* bundle, const BundleOptions& options);

// Per image the covariance (6, 6) of (centre in the world, rotation vector in the camera frame:
// camera_from_world <- exp(w) camera_from_world): the inverse of the normal equations with the
// points eliminated, times the variance of the residuals per degree of freedom. What the gauge of
// the options holds has variance 0. Lenses count as known. Throws SolveError if an image or the
// scale is not determined.
std::vector<Eigen::Matrix<double, 6, 6>> PoseCovariances(const Bundle& bundle,
                                                         const BundleOptions& options);

}  // namespace gsut
