// Tests that the bounds behind the adaptive footprint hold: derivatives of every lens over patches
// of directions, and the errors of EWA and the unscented transform that follow from them.
#include "gsut/projection/lens_bound.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "gsut/base/parallel.h"
#include "gsut/gaussians/activations.h"
#include "gsut/projection/footprint.h"
#include "gsut/projection/footprint_error.h"
#include "gsut/projection/lens_bend.h"
#include "random_gaussians.h"

namespace gsut {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using testing_scenes::Draws;
using testing_scenes::EveryLens;
using testing_scenes::GaussiansInView;
using testing_scenes::NamedCamera;
using testing_scenes::SceneKind;
using testing_scenes::ToDouble;

using Jacobian = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;

bool JacobianAt(const Camera& camera, const Vector3d& p, Jacobian* j) {
  double pixel[2];
  std::uint8_t valid = 0;
  camera.ProjectJacobian(1, p.data(), pixel, &valid, j->data(), nullptr);
  return valid != 0;
}

Vector3d RandomUnit(Draws* draws) {
  return Vector3d(draws->Normal(), draws->Normal(), draws->Normal()).normalized();
}

TEST(LensBoundTest, DerivativesOfEveryLensLieWithinTheirBounds) {
  constexpr int kPatches = 400, kPoints = 6;
  // Relative error of differences with this step: rounding of 1e-16 over its square, and its
  // square.
  constexpr double kStep = 1e-3, kDifference = 2e-3;
  std::uint64_t stream = 0;
  int lenses = 0;
  for (const NamedCamera& lens : EveryLens(48)) {
    Draws draws(21, stream++);
    int bounded = 0, third_bounded = 0, compared = 0;
    double share[3] = {0.0, 0.0, 0.0};
    for (int patch = 0; patch < kPatches; ++patch) {
      const int face = static_cast<int>(draws.Index(6));
      const double half = draws.LogUniform(0.003, 0.04);
      const double x = draws.Uniform(-1.0, 1.0), y = draws.Uniform(-1.0, 1.0);
      const Bend bend = BoundBend(lens.camera, face, {x - half, x + half}, {y - half, y + half});
      if (!std::isfinite(bend.second)) continue;
      ++bounded;
      third_bounded += std::isfinite(bend.third);
      for (int k = 0; k < kPoints; ++k) {
        Vector3d p;
        FacePoint(face, x + half * draws.Uniform(-1, 1), y + half * draws.Uniform(-1, 1), p.data());
        p.normalize();
        const Vector3d h = RandomUnit(&draws);
        Jacobian here, plus, minus;
        ASSERT_TRUE(JacobianAt(lens.camera, p, &here)) << lens.name;
        if (!JacobianAt(lens.camera, p + kStep * h, &plus) ||
            !JacobianAt(lens.camera, p - kStep * h, &minus)) {
          continue;
        }
        const double found[3] = {
            (here * h).cwiseAbs().maxCoeff(),
            ((plus - minus) * h).cwiseAbs().maxCoeff() / (2.0 * kStep),
            ((plus + minus - 2.0 * here) * h).cwiseAbs().maxCoeff() / (kStep * kStep)};
        const double bound[3] = {bend.first, bend.second, bend.third};
        for (int order = 0; order < 3; ++order) {
          const double slack = kDifference * bound[order] + 1e-9 * bend.first / (kStep * kStep);
          EXPECT_LE(found[order], bound[order] + slack)
              << lens.name << " order " << order + 1 << " at " << p.transpose();
          if (std::isfinite(bound[order]) && bound[order] > 0.0) {
            share[order] = std::max(share[order], found[order] / bound[order]);
          }
        }
        ++compared;
      }
    }
    std::printf("%-28s %3d of %d patches bounded (third %3d); largest share %.2f %.2f %.2f\n",
                lens.name.c_str(), bounded, kPatches, third_bounded, share[0], share[1], share[2]);
    EXPECT_GT(bounded, 10) << lens.name;
    EXPECT_GT(compared, 50) << lens.name;
    ++lenses;
  }
  EXPECT_EQ(lenses, static_cast<int>(EveryLens(48).size()));
}

// Points and weights of Gauss and Legendre on [-1, 1].
std::vector<std::array<double, 2>> GaussLegendre(int n) {
  std::vector<std::array<double, 2>> rule;
  for (int i = 0; i < n; ++i) {
    double x = std::cos(kPi * (i + 0.75) / (n + 0.5)), slope = 1.0;
    for (int step = 0; step < 50; ++step) {
      double before = 1.0, p = x;
      for (int k = 2; k <= n; ++k) {
        const double next = ((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k;
        before = p;
        p = next;
      }
      slope = n * (x * p - before) / (x * x - 1.0);
      x -= p / slope;
    }
    rule.push_back({x, 2.0 / ((1.0 - x * x) * slope * slope)});
  }
  return rule;
}

// A standard normal vector cut off at kFullReach, as weighted points.
struct CutNormal {
  std::vector<Vector3d> points;
  std::vector<double> weights;

  CutNormal() {
    constexpr int kRadial = 6, kHeight = 5, kAround = 10;
    double total = 0.0;
    for (const auto& [radial, radial_weight] : GaussLegendre(kRadial)) {
      const double r = 0.5 * kFullReach * (1.0 + radial);
      const double density = radial_weight * r * r * std::exp(-0.5 * r * r);
      for (const auto& [z, height_weight] : GaussLegendre(kHeight)) {
        const double level = std::sqrt(1.0 - z * z);
        for (int k = 0; k < kAround; ++k) {
          const double angle = 2.0 * kPi * k / kAround;
          points.emplace_back(r * level * std::cos(angle), r * level * std::sin(angle), r * z);
          weights.push_back(density * height_weight);
          total += weights.back();
        }
      }
    }
    for (double& weight : weights) weight /= total;
  }
};

std::int64_t GaussiansALens() {
  const char* text = std::getenv("GSUT_FOOTPRINTS");
  return text == nullptr ? 10000 : std::atoll(text);
}

struct Periods {
  double u = 0.0, v = 0.0;
};

Periods PeriodsOf(const Camera& camera) {
  Periods periods;
  VisitLens(camera.lens(), [&](auto lens) {
    using Lens = decltype(lens);
    if constexpr (requires { Lens::Period(camera.domain(), nullptr, nullptr, nullptr); }) {
      Lens::Period(camera.domain(), camera.params().data(), &periods.u, &periods.v);
    }
  });
  return periods;
}

// Pixel of a point on the side of `near` of a seam; false without one.
bool PixelNear(const Camera& camera, const Periods& periods, const Vector3d& p,
               const Vector2d& near, Vector2d* pixel) {
  std::uint8_t valid = 0;
  camera.Project(1, p.data(), pixel->data(), &valid);
  for (const auto& [axis, period] : {std::pair{0, periods.u}, std::pair{1, periods.v}}) {
    if (period > 0.0) {
      (*pixel)[axis] -= period * std::round(((*pixel)[axis] - near[axis]) / period);
    }
  }
  return valid != 0;
}

TEST(LensBoundTest, ErrorsOfEwaAndUnscentedNeverExceedTheirProvenBoundOnAnyLens) {
  constexpr int kOutline = 64;
  // What 64 samples of an outline may miss of its half size: 1 - cos(pi / 64), and its bend.
  constexpr double kOutlineGap = 2.5e-3;
  constexpr double kRounding = 1e-7;  // pixels
  const CutNormal normal;
  std::uint64_t stream = 0;
  std::int64_t checked_lenses = 0;
  for (const NamedCamera& lens : EveryLens(64)) {
    Draws draws(22, stream++);
    const SceneKind kind = {"small to large", 1.0, 6.0, 0.0005, 0.08, 0.7, 1.0};
    const std::int64_t n = GaussiansALens();
    const auto g = ToDouble(GaussiansInView(lens.camera, Pose(), n, kind, &draws));
    const Periods periods = PeriodsOf(lens.camera);
    const std::shared_ptr<const LensBend> bends = BendOf(lens.camera);
    FootprintOptions options;
    Footprints<double> ewa, unscented;
    options.method = ProjectionMethod::kEwa;
    FindFootprintsReference(g.View(), lens.camera, Pose(), options, &ewa);
    options.method = ProjectionMethod::kUnscented;
    FindFootprintsReference(g.View(), lens.camera, Pose(), options, &unscented);
    std::vector<std::array<double, 3>> shares(static_cast<std::size_t>(n), {-1.0, -1.0, -1.0});
    ParallelFor(n, 64, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        const std::size_t j = static_cast<std::size_t>(i);
        const double cutoff = CutoffOf(Sigmoid(g.opacity_logits[j]), options.rule);
        if (!(cutoff > 0.0)) continue;
        const double reach = std::sqrt(cutoff);
        const Eigen::Map<const Vector3d> mean(&g.means[3 * j]);
        const Vector3d scale = Eigen::Map<const Eigen::Array3d>(&g.log_scales[3 * j]).exp();
        double r[9];
        RotationFromQuaternion(&g.quats[4 * j], r);
        const Eigen::Matrix3d axes =
            Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r);
        const double size = scale.maxCoeff() / mean.norm();
        const Bend bend = bends->At(mean.data(), BendSine(size, reach));
        const FootprintError error = BoundFootprintError(bend, size, reach);
        if (!std::isfinite(error.ewa)) continue;
        // Inside the domain for certain, so both have an answer.
        ASSERT_EQ(ewa.status[j], FootprintStatus::kBox) << lens.name;
        ASSERT_EQ(unscented.status[j], FootprintStatus::kBox) << lens.name;
        const Vector2d near(ewa.u[j], ewa.v[j]);
        // The outline: tangent points of the cut-off ellipsoid, a ball around w when whitened.
        const Vector3d w = (axes.transpose() * mean).cwiseQuotient(scale);
        const double sine2 = cutoff / w.squaredNorm();
        ASSERT_LT(sine2, 1.0);
        const Vector3d e1 = w.unitOrthogonal(), e2 = w.normalized().cross(e1);
        Eigen::Array2d low(1e30, 1e30), high(-1e30, -1e30);
        for (int k = 0; k < kOutline; ++k) {
          const double angle = 2.0 * kPi * k / kOutline;
          const Vector3d touch =
              (1.0 - sine2) * w +
              reach * std::sqrt(1.0 - sine2) * (std::cos(angle) * e1 + std::sin(angle) * e2);
          Vector2d pixel;
          ASSERT_TRUE(
              PixelNear(lens.camera, periods, axes * touch.cwiseProduct(scale), near, &pixel));
          low = low.min(pixel.array());
          high = high.max(pixel.array());
        }
        const Eigen::Array2d gap = kOutlineGap * 0.5 * (high - low) + kRounding;
        const auto box_share = [&](const Footprints<double>& f, double bound) {
          const Eigen::Array2d found_low(f.low_u[j], f.low_v[j]),
              found_high(f.high_u[j], f.high_v[j]);
          // Inwards the outline is what was sampled, outwards a gap more.
          const double off =
              std::max({(found_low - low).maxCoeff(), (high - found_high).maxCoeff(),
                        (low - gap - found_low).maxCoeff(), (found_high - high - gap).maxCoeff()});
          return std::max(off - kRounding, 0.0) / bound;
        };
        shares[j][0] = box_share(ewa, error.ewa);
        shares[j][1] = box_share(unscented, error.unscented_box);
        if (!std::isfinite(error.unscented_center)) continue;
        Vector2d center = Vector2d::Zero();
        for (std::size_t k = 0; k < normal.points.size(); ++k) {
          Vector2d pixel;
          ASSERT_TRUE(PixelNear(lens.camera, periods,
                                mean + axes * scale.cwiseProduct(normal.points[k]), near, &pixel));
          center += normal.weights[k] * (pixel - near);
        }
        const Vector2d off = Vector2d(unscented.u[j], unscented.v[j]) - near - center;
        shares[j][2] =
            std::max(off.cwiseAbs().maxCoeff() - kRounding, 0.0) / error.unscented_center;
        EXPECT_LE(center.cwiseAbs().maxCoeff(), error.ewa + kRounding) << lens.name;
      }
    });
    double worst[3] = {0.0, 0.0, 0.0};
    std::int64_t counted[3] = {0, 0, 0};
    for (const auto& share : shares) {
      for (std::size_t k = 0; k < 3; ++k) {
        if (share[k] < 0.0) continue;
        ++counted[k];
        worst[k] = std::max(worst[k], share[k]);
      }
    }
    std::printf(
        "%-28s of %lld: %lld bounded (centre %lld); error over bound at most %.3f %.3f %.3f\n",
        lens.name.c_str(), static_cast<long long>(n), static_cast<long long>(counted[0]),
        static_cast<long long>(counted[2]), worst[0], worst[1], worst[2]);
    for (const double share : worst) EXPECT_LE(share, 1.0) << lens.name;
    EXPECT_GT(counted[0], n / 20) << lens.name;
    ++checked_lenses;
  }
  EXPECT_EQ(checked_lenses, static_cast<std::int64_t>(EveryLens(64).size()));
}

}  // namespace
}  // namespace gsut
