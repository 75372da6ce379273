// Tests gsut/projection: cut-offs, and that small splats bound silhouettes.
#include "gsut/projection/project.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <vector>

#include "gsut/gaussians/activations.h"
#include "random_gaussians.h"

namespace gsut {
namespace {

using namespace testing_scenes;

// The extents of a small splat may miss its silhouette by this many pixels more than kSmallMargin
// says: the renderer widens them by as much for float rounding.
constexpr double kRoundingPixels = 0.01;

constexpr SceneKind kOrdinary = {"ordinary", 1.0, 6.0, 0.005, 0.1, 0.5, 0.0};
constexpr SceneKind kSmallAndThin = {"small", 1.0, 6.0, 0.0005, 0.03, 1.0, 0.0};

TEST(CutoffTest, TakesTheNearerOfAlphaAndResponse) {
  const FootprintRule own;
  EXPECT_NEAR(CutoffOf(1.0, Response::kMaximum, own), 2.0 * std::log(255.0), 1e-12);
  EXPECT_NEAR(CutoffOf(1.0 / 255.0, Response::kMaximum, own), 0.0, 1e-12);
  EXPECT_LT(CutoffOf(1e-3, Response::kMaximum, own), 0.0);
  const FootprintRule with_response = {1.0 / 255.0, 0.0113};
  EXPECT_NEAR(CutoffOf(1.0, Response::kMaximum, with_response), -2.0 * std::log(0.0113), 1e-12);
  EXPECT_NEAR(CutoffOf(0.1, Response::kMaximum, with_response), 2.0 * std::log(25.5), 1e-12);
  // Optical depth 2: 1 - exp(-2 G) is 1/255 at this D.
  const double cutoff = CutoffOf(2.0, Response::kExtinction, own);
  EXPECT_NEAR(-std::expm1(-2.0 * std::exp(-0.5 * cutoff)), 1.0 / 255.0, 1e-12);
}

// Points of the silhouette of the ellipsoid {D^2 = cutoff} of Gaussian i, in the camera frame: the
// tangent points of the cone of rays that touch it, exact. Empty if it holds the camera.
std::vector<Eigen::Vector3d> Silhouette(const OwnedGaussians<double>& g, std::size_t i,
                                        const Pose& pose, double cutoff) {
  constexpr int kPoints = 48;
  double r[9];
  RotationFromQuaternion(&g.quats[4 * i], r);
  const Eigen::Matrix3d axes =
      pose.rotation * Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r);
  const Eigen::Vector3d scale =
      Eigen::Map<const Eigen::Vector3d>(&g.log_scales[3 * i]).array().exp();
  const Eigen::Vector3d mean =
      pose.rotation * Eigen::Map<const Eigen::Vector3d>(&g.means[3 * i]) + pose.translation;
  // In whitened coordinates: a ball of radius sqrt(cutoff) at `center`, seen from the origin.
  const Eigen::Vector3d center = (axes.transpose() * mean).cwiseQuotient(scale);
  const double distance2 = center.squaredNorm();
  if (distance2 <= cutoff) return {};
  const Eigen::Vector3d toward = center.normalized();
  const Eigen::Vector3d e1 = toward.unitOrthogonal();
  const Eigen::Vector3d e2 = toward.cross(e1);
  const double sine2 = cutoff / distance2;
  const double radius = std::sqrt(cutoff * (1.0 - sine2));
  std::vector<Eigen::Vector3d> points;
  for (int k = 0; k < kPoints; ++k) {
    const double angle = 2.0 * std::numbers::pi * k / kPoints;
    const Eigen::Vector3d whitened =
        center - sine2 * center + radius * (std::cos(angle) * e1 + std::sin(angle) * e2);
    points.push_back(axes * scale.cwiseProduct(whitened));
  }
  return points;
}

// Whether a pixel lies in the image: beyond it nothing needs a bound.
bool InImage(const Camera& camera, const double* pixel) {
  return pixel[0] > 0.0 && pixel[0] < camera.width() && pixel[1] > 0.0 &&
         pixel[1] < camera.height();
}

TEST(ProjectTest, SmallSplatsHoldTheirSilhouetteOnEveryLens) {
  double worst =
      0.0;  // excess over the extent / (sine x larger extent); must stay below the margin
  int small = 0;
  std::uint64_t stream = 0;
  const FootprintRule rule;
  for (const NamedCamera& lens : EveryLens(400)) {
    int small_here = 0;
    for (const SceneKind& kind : {kOrdinary, kSmallAndThin}) {
      Draws draws(2, stream++);
      const Pose pose = RandomPose(&draws);
      const auto g = GaussiansInView(lens.camera, pose, 1500, kind, &draws);
      const auto exact = ToDouble(g);
      Splats splats;
      Project(g.View(), lens.camera, pose, {}, rule, &splats);
      for (std::size_t i = 0; i < static_cast<std::size_t>(g.size()); ++i) {
        if (splats.status[i] != SplatStatus::kSmall) continue;
        const double cutoff = CutoffOf(Sigmoid(exact.opacity_logits[i]), Response::kMaximum, rule);
        const auto points = Silhouette(exact, i, pose, cutoff);
        ASSERT_FALSE(points.empty());
        for (const Eigen::Vector3d& point : points) {
          double pixel[2];
          std::uint8_t valid = 0;
          lens.camera.Project(1, point.data(), pixel, &valid);
          if (!valid || !InImage(lens.camera, pixel)) continue;
          const double off[2] = {std::abs(pixel[0] - splats.u[i]),
                                 std::abs(pixel[1] - splats.v[i])};
          const double extent[2] = {splats.extent_u[i], splats.extent_v[i]};
          const double sine = splats.sine[i];
          for (int k = 0; k < 2; ++k) {
            const double excess = off[k] - kRoundingPixels - extent[k];
            worst = std::max(worst, excess / (sine * std::max(extent[0], extent[1])));
            EXPECT_LT(excess, BendMargin(sine, extent[0], extent[1]))
                << lens.name << " Gaussian " << i;
          }
        }
        ++small_here;
      }
    }
    EXPECT_GT(small_here, 500) << lens.name;
    small += small_here;
  }
  std::printf(
      "%d small splats: silhouettes exceed extents by at most %.3f x sine x the larger (margin "
      "%.1f)\n",
      small, worst, kSmallMargin);
}

}  // namespace
}  // namespace gsut
