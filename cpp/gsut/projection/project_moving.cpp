// The points of the unscented transform, each through the pose of the line that sees it.
#include "gsut/projection/project_moving.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "gsut/base/check_arguments.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/check_gaussians.h"
#include "gsut/projection/unscented_scalar.h"

namespace gsut {
namespace {

constexpr int kMaxSteps = 50;
constexpr double kSettled = 1e-9;  // of the exposure

// Pixels of points of the world; those that do not settle are NaN and clear converged[i] of their
// Gaussian i.
void PlaceOnLines(const Camera& camera, const CameraMotion& motion, std::int64_t count,
                  const double* points, double* pixels, std::uint8_t* converged) {
  const std::size_t n = static_cast<std::size_t>(count);
  std::vector<double> times(n, motion.MiddleTime()), in_camera(3 * n), found(2 * n);
  std::vector<std::uint8_t> valid(n);
  std::vector<std::size_t> moving(n);  // points that have not settled yet
  std::iota(moving.begin(), moving.end(), std::size_t{0});
  std::fill_n(pixels, 2 * n, std::numeric_limits<double>::quiet_NaN());
  // A fixed point, t = time of the line that the point falls on with the pose of time t. It
  // converges as the image moves by less than a line while a line is read; what does not is
  // reported.
  for (int step = 0; step < kMaxSteps && !moving.empty(); ++step) {
    for (std::size_t k = 0; k < moving.size(); ++k) {
      const Pose pose = motion.At(times[moving[k]]);
      Eigen::Vector3d::Map(&in_camera[3 * k]) =
          pose.rotation * Eigen::Vector3d::Map(points + 3 * moving[k]) + pose.translation;
    }
    camera.Project(static_cast<std::int64_t>(moving.size()), in_camera.data(), found.data(),
                   valid.data());
    std::size_t left = 0;
    for (std::size_t k = 0; k < moving.size(); ++k) {
      if (!valid[k]) continue;
      const double u = found[2 * k], v = found[2 * k + 1];
      const std::size_t i = moving[k];
      const double next =
          std::clamp(motion.shutter.PixelTime(u, v, camera.width(), camera.height()), 0.0, 1.0);
      if (std::abs(next - times[i]) <= kSettled) {
        pixels[2 * i] = u;
        pixels[2 * i + 1] = v;
        continue;
      }
      times[i] = next;
      moving[left++] = i;
    }
    moving.resize(left);
  }
  for (const std::size_t i : moving) converged[i / HWY_NAMESPACE::kUnscentedPoints] = 0;
}

}  // namespace

void ProjectMoving(const GaussiansView<const double>& gaussians, const Camera& camera,
                   const CameraMotion& motion, const UnscentedOptions& options, double* means,
                   double* covariances, std::uint8_t* valid, std::uint8_t* converged) {
  CheckGaussians(gaussians);
  CheckArray(means, gaussians.size, "means");
  CheckArray(covariances, gaussians.size, "covariances");
  CheckArray(valid, gaussians.size, "valid");
  CheckArray(converged, gaussians.size, "converged");
  const UnscentedWeights weights = MakeUnscentedWeights(options);
  std::fill_n(converged, gaussians.size, std::uint8_t{1});
  const auto through = [&](std::int64_t first, std::int64_t count, const double* points,
                           double* pixels) {
    PlaceOnLines(camera, motion, count, points, pixels, converged + first);
  };
  ParallelFor(gaussians.size, kScalarBatch, [&](std::int64_t begin, std::int64_t end) {
    UnscentedInDouble(gaussians, Pose(), camera.domain(), weights, begin, end, through,
                      [&](std::int64_t i, const ScalarFootprint& footprint) {
                        WriteFootprint(footprint, i, means, covariances, valid);
                      });
  });
}

}  // namespace gsut
