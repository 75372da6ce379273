// A made bundle: cameras along an arc around points, seen exactly.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <span>
#include <vector>

#include "gsut/base/rng.h"
#include "gsut/sfm/bundle.h"
#include "gsut/sfm/bundle_state.h"
#include "gsut/geometry/shutter.h"

namespace gsut {

class Numbers {
 public:
  explicit Numbers(std::uint64_t stream) : rng_(7, stream) {}
  double Normal() { return rng_.Normals(next_++)[0]; }
  double Uniform(double low, double high) { return low + (high - low) * rng_.Uniform(next_++); }
  Eigen::Vector3d Vector() { return {Normal(), Normal(), Normal()}; }
  Eigen::Vector3d Ray() { return Vector().normalized(); }
  Pose RandomPose(double shift) {
    Eigen::Matrix<double, 6, 1> turn;
    turn << 0, 0, 0, Vector();
    Pose pose = ExpPose(turn);
    pose.translation = shift * Vector();
    return pose;
  }

 private:
  Rng rng_;
  std::uint64_t next_ = 0;
};

// A fisheye of 200 degrees: points behind the camera plane have pixels.
inline Camera WideLens() {
  return Camera("kannala_brandt", {300, 301, 500, 505, 0.02, -0.01, 0.002, -0.0003}, 1000, 1010);
}

// Observations of all points by all images, exact, as the bundle's poses, motions and rigs have it;
// of a rolling shutter from top to bottom where it has velocities.
inline void ObserveAll(Bundle* bundle) {
  bundle->observations.clear();
  const BundleState state(*bundle);
  const Shutter shutter = Shutter::Named("top_to_bottom");
  for (int p = 0; p < static_cast<int>(bundle->points.size()); ++p) {
    for (int i = 0; i < static_cast<int>(bundle->camera_from_world.size()); ++i) {
      const Camera& camera = bundle->cameras[bundle->camera_of_image[i]];
      BundleObservation observation;
      observation.image = i;
      observation.point = p;
      std::uint8_t valid = 0;
      // The line that sees the point: a fixed point of the motion.
      const int rounds = bundle->velocities.empty() ? 1 : 60;
      for (int round = 0; round < rounds; ++round) {
        const Eigen::Vector3d in_camera = state.Chain(observation).Point(bundle->points[p]);
        camera.Project(1, in_camera.data(), observation.pixel.data(), &valid);
        if (!valid) break;
        if (rounds > 1) {
          observation.time = shutter.PixelTime(observation.pixel.x(), observation.pixel.y(),
                                               camera.width(), camera.height()) -
                             0.5;
        }
      }
      const bool inside = valid && observation.pixel.minCoeff() > 0 &&
                          observation.pixel.x() < camera.width() &&
                          observation.pixel.y() < camera.height();
      if (!inside && rounds > 1) continue;
      if (!valid) continue;
      std::vector<std::uint8_t> has_ray;
      observation.bearing = MakeBearings(camera, std::span(&observation.pixel, 1), &has_ray)[0];
      if (has_ray[0]) bundle->observations.push_back(observation);
    }
  }
}

// Cameras along an arc around points, seen exactly.
inline Bundle MakeBundle(const Camera& camera, int images, int points, std::uint64_t stream) {
  Numbers numbers(stream);
  Bundle bundle;
  bundle.cameras = {camera};
  bundle.camera_of_image.assign(images, 0);
  for (int i = 0; i < images; ++i) {
    Eigen::Matrix<double, 6, 1> twist;
    twist << 0.4 * i, 0.1 * (i % 3), 0.05 * i * i, 0.05 * i, -0.1 * i, 0.02;
    bundle.camera_from_world.push_back(i == 0 ? Pose() : ExpPose(twist));
  }
  for (int p = 0; p < points; ++p) {
    bundle.points.emplace_back(numbers.Uniform(-4, 4), numbers.Uniform(-4, 4),
                               numbers.Uniform(-0.3, 5));
  }
  ObserveAll(&bundle);
  return bundle;
}

// Two cameras on a rig: images 2 i and 2 i + 1 are of body i.
inline Bundle RigBundle(int points, std::uint64_t stream) {
  Bundle bundle = MakeBundle(WideLens(), 8, points, stream);
  Eigen::Matrix<double, 6, 1> twist;
  twist << -0.2, 0.02, 0.01, 0.02, 0.3, -0.01;
  bundle.camera_from_body = {ExpPose(twist)};
  for (int i = 0; i < 8; ++i) {
    bundle.body_of_image.push_back(i / 2);
    bundle.mount_of_image.push_back(i % 2 == 0 ? -1 : 0);
  }
  const BundleState state(bundle);
  for (int i = 0; i < 8; ++i) bundle.camera_from_world[i] = state.CameraFromWorld(i);
  ObserveAll(&bundle);
  return bundle;
}

// Root of the mean squared residual in pixels that a cost means; under a loss a lower bound of it.
inline double LengthOf(double cost, const Bundle& bundle) {
  return std::sqrt(2.0 * cost / static_cast<double>(bundle.observations.size()));
}

inline void Disturb(Bundle* bundle, std::uint64_t stream) {
  Numbers numbers(stream);
  for (std::size_t i = 1; i < bundle->camera_from_world.size(); ++i) {
    Eigen::Matrix<double, 6, 1> twist;
    twist << 0.02 * numbers.Vector(), 0.01 * numbers.Vector();
    bundle->camera_from_world[i] = ExpPose(twist) * bundle->camera_from_world[i];
  }
  for (Eigen::Vector3d& point : bundle->points) point += 0.02 * numbers.Vector();
}

}  // namespace gsut
