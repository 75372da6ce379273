// Tests gsut/optimize's compaction: moments, blocks, merging, GHAP as published.
#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>
#include <set>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/activations.h"
#include "gsut/optimize/blocks.h"
#include "gsut/optimize/cluster.h"
#include "gsut/optimize/compact.h"
#include "gsut/optimize/merge_block.h"
#include "gsut/optimize/moments.h"

namespace gsut {
namespace {

// Thomsen's formula for the surface of an ellipsoid promises 1.061 %.
constexpr double kShadowRelative = 0.0107;
// Covariance to float quaternion and log-scales and back: a dozen roundings of 6e-8; worst 4e-7.
constexpr double kParametersRelative = 1e-6;
constexpr double kDoubleRelative = 1e-12;
constexpr int kThreads[] = {1, 2, 8};

// Random Gaussians of all shapes on a few surfaces.
GaussianArrays RandomScene(std::int64_t size, int sh_coefficients, unsigned seed) {
  GaussianArrays g(size, sh_coefficients);
  std::mt19937_64 engine(seed);
  std::normal_distribution<float> normal;
  std::uniform_real_distribution<float> uniform(-1, 1);
  for (std::int64_t i = 0; i < size; ++i) {
    const auto at = static_cast<std::size_t>(i);
    g.means[3 * at] = 2 * uniform(engine);
    g.means[3 * at + 1] = uniform(engine);
    g.means[3 * at + 2] = std::floor(2 * uniform(engine)) + 0.01f * normal(engine);
    for (std::size_t k = 0; k < 4; ++k) g.quats[4 * at + k] = normal(engine);
    for (std::size_t k = 0; k < 3; ++k) g.log_scales[3 * at + k] = -4 + normal(engine);
    g.opacity_logits[at] = 2 * normal(engine);
  }
  for (float& value : g.sh) value = 0.3f * normal(engine);
  return g;
}

GaussiansView<const float> Read(GaussianArrays& g) { return g.View().AsConst(); }

std::vector<std::uint32_t> AllRows(std::int64_t size) {
  std::vector<std::uint32_t> rows(static_cast<std::size_t>(size));
  for (std::size_t i = 0; i < rows.size(); ++i) rows[i] = static_cast<std::uint32_t>(i);
  return rows;
}

TEST(Moments, ShadowAreaOfSphereDiscAndNeedleAgreesWithIntegration) {
  const double shapes[][3] = {{1, 1, 1}, {1, 1, 0}, {3, 2, 1}, {1, 0.2, 0.01}, {5, 0.1, 0.1}};
  for (const auto& s : shapes) {
    // The shadow along a unit direction d has the area |diag(bc, ac, ab) d| times pi.
    double sum = 0.0;
    constexpr int kSteps = 400;
    for (int i = 0; i < kSteps; ++i) {
      const double z = (2.0 * i + 1.0) / kSteps - 1.0;
      for (int j = 0; j < kSteps; ++j) {
        const double angle = 2.0 * std::numbers::pi * (j + 0.5) / kSteps;
        const double x = std::sqrt(1 - z * z) * std::cos(angle);
        const double y = std::sqrt(1 - z * z) * std::sin(angle);
        sum += std::sqrt(std::pow(s[1] * s[2] * x, 2) + std::pow(s[0] * s[2] * y, 2) +
                         std::pow(s[0] * s[1] * z, 2));
      }
    }
    const double expected = sum / (kSteps * kSteps);
    EXPECT_NEAR(ShadowArea(s[0], s[1], s[2]), expected, kShadowRelative * expected);
  }
}

TEST(Moments, ParametersOfCovarianceGoBackToIt) {
  GaussianArrays g = RandomScene(200, 1, 3);
  GaussianArrays back(200, 1);
  for (std::int64_t i = 0; i < g.size; ++i) {
    const Eigen::Matrix3d expected = CovarianceOf(Read(g), i);
    ParametersOf(expected, 0.0, &back.quats[static_cast<std::size_t>(4 * i)],
                 &back.log_scales[static_cast<std::size_t>(3 * i)]);
    const Eigen::Matrix3d found = CovarianceOf(Read(back), i);
    EXPECT_LE((found - expected).norm(), kParametersRelative * expected.norm()) << i;
  }
}

TEST(Moments, MergeKeepsTheMixturesMeanAndCovariance) {
  std::mt19937_64 engine(5);
  std::normal_distribution<double> normal;
  Moments a, b;
  a.weight = 0.7;
  b.weight = 2.1;
  a.mean = Eigen::Vector3d(normal(engine), normal(engine), normal(engine));
  b.mean = Eigen::Vector3d(normal(engine), normal(engine), normal(engine));
  const Eigen::Matrix3d root = Eigen::Matrix3d::NullaryExpr([&] { return normal(engine); });
  a.covariance = root * root.transpose();
  b.covariance = 0.1 * root.transpose() * root;
  const Moments both = MergeMoments(a, b);
  // First and second raw moments of the mixture.
  const Eigen::Vector3d first = (a.weight * a.mean + b.weight * b.mean) / 2.8;
  const Eigen::Matrix3d second = (a.weight * (a.covariance + a.mean * a.mean.transpose()) +
                                  b.weight * (b.covariance + b.mean * b.mean.transpose())) /
                                 2.8;
  EXPECT_LE((both.mean - first).norm(), kDoubleRelative);
  EXPECT_LE((both.covariance + both.mean * both.mean.transpose() - second).norm(),
            kDoubleRelative * second.norm());
}

TEST(Blocks, AreBalancedAndHoldEveryRowOnceOnAnyNumberOfThreads) {
  GaussianArrays g = RandomScene(5000, 1, 7);
  for (const BlockAxis axis : {BlockAxis::kCycle, BlockAxis::kPrincipal}) {
    SetNumThreads(1);
    const Blocks one = SplitIntoBlocks(g.means.data(), AllRows(5000), 5, axis);
    ASSERT_EQ(one.size(), 32);
    for (std::int64_t b = 0; b < one.size(); ++b) {
      const auto rows =
          one.begin[static_cast<std::size_t>(b) + 1] - one.begin[static_cast<std::size_t>(b)];
      EXPECT_TRUE(rows == 156 || rows == 157) << rows;
    }
    EXPECT_EQ(std::set<std::uint32_t>(one.order.begin(), one.order.end()).size(), 5000u);
    for (const int threads : kThreads) {
      SetNumThreads(threads);
      EXPECT_EQ(SplitIntoBlocks(g.means.data(), AllRows(5000), 5, axis).order, one.order);
    }
  }
  SetNumThreads(0);
}

TEST(MergePairs, KeepsTheBitsOfWhatIsNotMerged) {
  GaussianArrays g = RandomScene(1000, 1, 13);
  const GaussianArrays out = MergePairs(Read(g), AllRows(1000), nullptr, 900, MergeOptions());
  std::set<std::vector<float>> before;
  for (std::size_t i = 0; i < 1000; ++i) {
    before.insert({g.means[3 * i], g.means[3 * i + 1], g.means[3 * i + 2], g.opacity_logits[i]});
  }
  int same = 0;
  for (std::size_t i = 0; i < 900; ++i) {
    same += before.count({out.means[3 * i], out.means[3 * i + 1], out.means[3 * i + 2],
                          out.opacity_logits[i]}) > 0;
  }
  EXPECT_GE(same, 800);  // 100 merges touch at most 200 of 1000
}

TEST(MergePairs, CheapestPairFirstAsAnExhaustiveSearchFindsIt) {
  constexpr std::int64_t kSize = 24;
  GaussianArrays g = RandomScene(kSize, 1, 17);
  const auto rows = AllRows(kSize);
  MergeOptions options;
  options.neighbors = kSize;  // all are candidates
  const std::vector<MergeStep> steps =
      PlanMerges(Read(g), {rows.data(), kSize}, nullptr, 4, options);
  ASSERT_EQ(steps.size(), 20u);
  double origin[3] = {0, 0, 0};
  std::vector<Cluster> clusters;
  clusters.reserve(kSize);
  for (std::int64_t i = 0; i < kSize; ++i) clusters.push_back(ClusterOf(Read(g), i, -1.0, origin));
  std::vector<bool> alive(kSize, true);
  for (const MergeStep& step : steps) {
    double least = 1e300;
    for (std::size_t a = 0; a < kSize; ++a) {
      for (std::size_t b = a + 1; b < kSize && alive[a]; ++b) {
        if (alive[b]) least = std::min(least, CostOfMerging(clusters[a], clusters[b], options));
      }
    }
    EXPECT_NEAR(step.cost, least, 1e-6 * least);  // means are relative to another origin
    clusters[step.into] = Merge(clusters[step.into], clusters[step.other]);
    alive[step.other] = false;
  }
}

TEST(MergePairs, TwoSideBySideKeepOpacityTimesAreaAndTwoAtOnePlaceTheirUnion) {
  GaussianArrays g(2, 1);
  for (std::size_t i = 0; i < 2; ++i) {
    g.means[3 * i] = i == 0 ? -0.5f : 0.5f;
    g.quats[4 * i] = 1;
    g.opacity_logits[i] = static_cast<float>(Logit(0.6));
    for (std::size_t k = 0; k < 3; ++k) g.sh[3 * i + k] = i == 0 ? 1.0f : -0.5f;
  }
  GaussianArrays out = MergePairs(Read(g), AllRows(2), nullptr, 1, MergeOptions());
  ASSERT_EQ(out.size, 1);
  const double area = ShadowArea(CovarianceOf(Read(out), 0));
  const double opacity = Sigmoid(static_cast<double>(out.opacity_logits[0]));
  EXPECT_NEAR(opacity * area, std::min(2 * 0.6, (1 - 0.4 * 0.4) * area), 1e-6);
  EXPECT_NEAR(out.means[0], 0.0, 1e-6);
  EXPECT_NEAR(out.sh[0], 0.25, 1e-6);
  EXPECT_NEAR(CovarianceOf(Read(out), 0)(0, 0), 1.25, 1e-6);  // 1 within, 0.25 between
  g.means[0] = g.means[3] = 0.0f;
  out = MergePairs(Read(g), AllRows(2), nullptr, 1, MergeOptions());
  EXPECT_NEAR(Sigmoid(static_cast<double>(out.opacity_logits[0])), 1 - 0.4 * 0.4, 1e-6);
}

TEST(MergePairs, WhatIsNotSeenChangesNothing) {
  GaussianArrays g = RandomScene(40, 1, 19);
  std::vector<float> weights(40, 0.0f);
  for (std::size_t i = 0; i < 20; ++i) weights[i] = 10.0f;
  const GaussianArrays out = MergePairs(Read(g), AllRows(40), weights.data(), 20, MergeOptions());
  ASSERT_EQ(out.size, 20);
  for (std::size_t k = 0; k < 60; ++k) EXPECT_NEAR(out.means[k], g.means[k], 1e-6);
  for (std::size_t k = 0; k < 60; ++k) EXPECT_NEAR(out.sh[k], g.sh[k], 1e-6);
  for (std::size_t k = 0; k < 20; ++k) {
    EXPECT_NEAR(Sigmoid(out.opacity_logits[k]), Sigmoid(g.opacity_logits[k]), 1e-5);
  }
}

TEST(HerdPaper, KeepingAllGivesTheSameGaussians) {
  GaussianArrays g = RandomScene(64, 1, 29);
  HerdOptions options;
  options.keep = 1.0;
  options.depth = 3;
  options.least_variance = 0.0;
  GaussianArrays out = HerdPaper(Read(g), AllRows(64), options);
  ASSERT_EQ(out.size, 64);
  std::multiset<float> before(g.means.begin(), g.means.end());
  for (const float value : out.means) EXPECT_EQ(before.count(value), 1u);
}

TEST(HerdPaper, OneCentreIsTheAverageWithoutBetweenMeansTerm) {
  GaussianArrays g = RandomScene(10, 4, 31);
  HerdOptions options;
  options.keep = 0.1;
  options.least_variance = 0.0;
  GaussianArrays out = HerdPaper(Read(g), AllRows(10), options);
  ASSERT_EQ(out.size, 1);
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  double total = 0.0;
  for (std::int64_t i = 0; i < 10; ++i) {
    const double o = Sigmoid(static_cast<double>(g.opacity_logits[static_cast<std::size_t>(i)]));
    total += o;
    covariance += o * CovarianceOf(Read(g), i);
    for (int k = 0; k < 3; ++k) mean[k] += o * g.means[static_cast<std::size_t>(3 * i + k)];
  }
  EXPECT_LE((CovarianceOf(Read(out), 0) - covariance / total).norm(),
            kParametersRelative * covariance.norm());
  for (int k = 0; k < 3; ++k)
    EXPECT_NEAR(out.means[static_cast<std::size_t>(k)], mean[k] / total, 1e-6);
  // Opacity and harmonics are one member's.
  const auto source =
      std::find(g.opacity_logits.begin(), g.opacity_logits.end(), out.opacity_logits[0]) -
      g.opacity_logits.begin();
  ASSERT_LT(source, 10);
  for (std::size_t k = 0; k < 12; ++k) {
    EXPECT_EQ(out.sh[k], g.sh[12 * static_cast<std::size_t>(source) + k]);
  }
}

}  // namespace
}  // namespace gsut
