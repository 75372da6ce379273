// Adjusts poses, speeds and points of a camera with a rolling shutter, from made observations.
#include <gsut/cameras/camera.h>
#include <gsut/geometry/rotation_vector.h>
#include <gsut/sfm/bundle.h>

#include <cstdio>
#include <random>
#include <vector>

int main() {
  constexpr int kImages = 8, kPoints = 200, kWidth = 640, kHeight = 480;
  std::mt19937 random(1);
  std::uniform_real_distribution<double> between(-1.0, 1.0);
  std::normal_distribution<double> noise(0.0, 0.3);  // pixels
  const auto vector = [&] {
    return Eigen::Vector3d(between(random), between(random), between(random));
  };
  const gsut::Camera camera("kannala_brandt", {300, 300, 320, 240, 0.02, 0, 0, 0}, kWidth, kHeight);

  gsut::Bundle truth;
  truth.cameras = {camera};
  for (int i = 0; i < kPoints; ++i) truth.points.push_back(3.0 * vector());
  for (int i = 0; i < kImages; ++i) {  // a walk past the points
    gsut::Pose pose;
    // Held at several angles: lines that all run the same way leave a shear of the scene open.
    pose.rotation = gsut::RotationOfVector({0.0, 0.0, i % 2 == 0 ? -0.7 : 0.7});
    pose.translation = Eigen::Vector3d(2.0 - 0.5 * i, 0.3 * between(random), 6.0);
    truth.camera_from_world.push_back(pose);
    gsut::Velocity velocity;  // metres and radians in one readout
    velocity << 0.1 * vector(), 0.05 * vector();
    truth.velocities.push_back(velocity);
    truth.camera_of_image.push_back(0);
  }

  // A point is seen at the line that is being read while its image lies there: iterate.
  for (int image = 0; image < kImages; ++image) {
    for (int point = 0; point < kPoints; ++point) {
      gsut::BundleObservation seen;
      seen.image = image, seen.point = point;
      std::uint8_t valid = 0;
      for (int i = 0; i < 20; ++i) {
        const gsut::Pose pose =
            gsut::MovedPose(truth.camera_from_world[image], truth.velocities[image], seen.time);
        const Eigen::Vector3d in_camera = pose.rotation * truth.points[point] + pose.translation;
        camera.Project(1, in_camera.data(), seen.pixel.data(), &valid);
        seen.time = seen.pixel.y() / kHeight - 0.5;
      }
      if (!valid || seen.pixel.y() < 0 || seen.pixel.y() > kHeight) continue;
      seen.pixel += Eigen::Vector2d(noise(random), noise(random));
      std::vector<std::uint8_t> has_ray;
      seen.bearing = gsut::MakeBearings(camera, std::span(&seen.pixel, 1), &has_ray)[0];
      truth.observations.push_back(seen);
    }
  }

  gsut::Bundle bundle = truth;  // from poses that are off, cameras that stand still
  for (Eigen::Vector3d& point : bundle.points) point += 0.05 * vector();
  for (gsut::Velocity& velocity : bundle.velocities) velocity.setZero();
  gsut::BundleOptions options;
  options.image_fixed.assign(kImages, 0);
  options.gauge_image = 0, options.scale_image = kImages - 1;
  gsut::VelocityPrior prior;
  prior.sigma.setConstant(0.2);
  options.velocity_priors.assign(kImages, prior);
  options.noise = 0.3;
  const gsut::BundleSummary summary = gsut::AdjustBundle(&bundle, options);

  double before = 0.0, after = 0.0;
  for (int i = 0; i < kImages; ++i) {
    before += truth.velocities[i].tail<3>().norm() / kImages;
    after += (bundle.velocities[i] - truth.velocities[i]).tail<3>().norm() / kImages;
  }
  std::printf("%zu observations: cost %.0f -> %.0f; turn in a readout off by %.4f -> %.4f rad\n",
              bundle.observations.size(), summary.cost_before, summary.cost_after, before, after);
}
