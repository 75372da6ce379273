// Tests gsut/gaussians: activations, spherical harmonics, seeding.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "gsut/gaussians/activations.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/harmonics.h"
#include "gsut/gaussians/seed.h"
#include "gsut/gaussians/seed_neighbors.h"

namespace gsut {
namespace {

// Central differences with step h in double: h^2 f''' / 6 + eps / h ~ 1e-10 at h = 1e-5.
constexpr double kStep = 1e-5;
constexpr double kDifferenceTolerance = 1e-8;
// Sums of a few hundred terms of order 1 in double.
constexpr double kQuadratureTolerance = 1e-12;
// A handful of operations on numbers of order 1 in double.
constexpr double kRoundingTolerance = 1e-14;
// exp(30) eps: what is left of a logit of 30 after its opacity was rounded near 1.
constexpr double kLogitTolerance = 2.4e-3;
// Differences of rotations: values up to 20, and third derivatives of order 1 / |q|^3.
constexpr double kQuaternionTolerance = 1e-6;

struct Sphere {
  std::mt19937_64 engine{20260821};
  std::normal_distribution<double> normal;
  void Draw(double* direction) {
    double squares = 0;
    for (int i = 0; i < 3; ++i) {
      direction[i] = normal(engine);
      squares += direction[i] * direction[i];
    }
    for (int i = 0; i < 3; ++i) direction[i] /= std::sqrt(squares);
  }
};

TEST(ActivationsTest, SigmoidAndLogitAreInverse) {
  for (const double logit : {-30.0, -5.0, -0.1, 0.0, 0.3, 8.0, 30.0}) {
    EXPECT_NEAR(Logit(Sigmoid(logit)), logit, logit < 9 ? kQuadratureTolerance : kLogitTolerance);
    EXPECT_NEAR((Sigmoid(logit + kStep) - Sigmoid(logit - kStep)) / (2 * kStep),
                SigmoidDerivative(Sigmoid(logit)), kDifferenceTolerance);
  }
  EXPECT_EQ(Sigmoid(-1000.0f), 0.0f);
  EXPECT_EQ(Sigmoid(1000.0f), 1.0f);
}

TEST(ActivationsTest, RotationDoesNotDependOnTheNorm) {
  const double quat[4] = {0.3, -0.5, 0.7, 0.2};
  double expected[9];
  RotationFromQuaternion(quat, expected);
  double determinant = expected[0] * (expected[4] * expected[8] - expected[5] * expected[7]) -
                       expected[1] * (expected[3] * expected[8] - expected[5] * expected[6]) +
                       expected[2] * (expected[3] * expected[7] - expected[4] * expected[6]);
  EXPECT_NEAR(determinant, 1.0, kRoundingTolerance);
  for (const double factor : {1e-300, 1e-160, 1e-3, -1.0, 1e5, 1e200, 1e300}) {
    const double scaled[4] = {quat[0] * factor, quat[1] * factor, quat[2] * factor,
                              quat[3] * factor};
    double rotation[9];
    RotationFromQuaternion(scaled, rotation);
    for (int i = 0; i < 9; ++i) EXPECT_NEAR(rotation[i], expected[i], kRoundingTolerance) << factor;
  }
}

TEST(ActivationsTest, QuaternionGradientMatchesCentralDifferences) {
  std::mt19937_64 engine(1);
  std::normal_distribution<double> normal;
  for (int trial = 0; trial < 20; ++trial) {
    double quat[4], weights[9], gradient[4];
    for (double& q : quat) q = 2 * normal(engine);
    for (double& w : weights) w = normal(engine);
    RotationFromQuaternionBackward(quat, weights, gradient);
    const auto value = [&](const double* q) {
      double rotation[9], sum = 0;
      RotationFromQuaternion(q, rotation);
      for (int i = 0; i < 9; ++i) sum += weights[i] * rotation[i];
      return sum;
    };
    double along = 0;
    for (int i = 0; i < 4; ++i) {
      double plus[4], minus[4];
      std::copy(quat, quat + 4, plus);
      std::copy(quat, quat + 4, minus);
      plus[i] += kStep;
      minus[i] -= kStep;
      EXPECT_NEAR(gradient[i], (value(plus) - value(minus)) / (2 * kStep), kQuaternionTolerance);
      along += gradient[i] * quat[i];
    }
    EXPECT_NEAR(along, 0.0, kQuadratureTolerance);  // the norm does not matter
  }
}

TEST(HarmonicsTest, GradientMatchesCentralDifferences) {
  Sphere sphere;
  int cases = 0;
  for (int degree = 0; degree <= 3; ++degree) {
    for (int trial = 0; trial < 10; ++trial, ++cases) {
      double direction[3], weights[16], gradient[3];
      sphere.Draw(direction);
      for (double& w : weights) w = sphere.normal(sphere.engine);
      HarmonicsBasisGradient(degree, direction[0], direction[1], direction[2], weights, gradient);
      const auto value = [&](const double* d) {
        double basis[16], sum = 0;
        HarmonicsBasis(degree, d[0], d[1], d[2], basis);
        for (int k = 0; k < NumShCoefficients(degree); ++k) sum += weights[k] * basis[k];
        return sum;
      };
      for (int i = 0; i < 3; ++i) {
        double plus[3] = {direction[0], direction[1], direction[2]};
        double minus[3] = {direction[0], direction[1], direction[2]};
        plus[i] += kStep;
        minus[i] -= kStep;
        EXPECT_NEAR(gradient[i], (value(plus) - value(minus)) / (2 * kStep), kDifferenceTolerance);
      }
    }
  }
  EXPECT_EQ(cases, 40);
}

TEST(HarmonicsTest, ColorGradientMatchesCentralDifferences) {
  Sphere sphere;
  double direction[3], sh[48], weights[3], dl_dsh[48], dl_ddirection[3], color[3];
  sphere.Draw(direction);
  for (double& value : sh) value = 0.2 * sphere.normal(sphere.engine);
  for (double& value : weights) value = sphere.normal(sphere.engine);
  sh[2] = -20;  // clamps blue
  const unsigned clamped = EvalHarmonics(3, direction, sh, color);
  ASSERT_EQ(clamped, 4u);
  EvalHarmonicsBackward(3, direction, sh, clamped, weights, dl_dsh, dl_ddirection);
  const auto value = [&] {
    double c[3];
    EvalHarmonics(3, direction, sh, c);
    return weights[0] * c[0] + weights[1] * c[1] + weights[2] * c[2];
  };
  const auto difference = [&](double* at) {
    const double saved = *at;
    *at = saved + kStep;
    const double plus = value();
    *at = saved - kStep;
    const double minus = value();
    *at = saved;
    return (plus - minus) / (2 * kStep);
  };
  for (int i = 0; i < 48; ++i) EXPECT_NEAR(dl_dsh[i], difference(sh + i), kDifferenceTolerance);
  for (int i = 0; i < 3; ++i) {
    EXPECT_NEAR(dl_ddirection[i], difference(direction + i), kDifferenceTolerance);
  }
}

std::vector<double> BruteForceDistances(const std::vector<double>& points) {
  const std::size_t n = points.size() / 3;
  std::vector<double> means(n, 0.0);
  for (std::size_t i = 0; i < n; ++i) {
    std::vector<double> all;
    for (std::size_t j = 0; j < n; ++j) {
      if (j == i) continue;
      double squares = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        squares +=
            (points[3 * i + k] - points[3 * j + k]) * (points[3 * i + k] - points[3 * j + k]);
      }
      all.push_back(std::sqrt(squares));
    }
    std::sort(all.begin(), all.end());
    const std::size_t used = std::min<std::size_t>(3, all.size());
    for (std::size_t k = 0; k < used; ++k) means[i] += all[k] / static_cast<double>(used);
  }
  return means;
}

TEST(SeedTest, DistancesToNeighborsMatchBruteForce) {
  std::mt19937_64 engine(2);
  std::normal_distribution<double> normal;
  for (const int n : {0, 1, 2, 3, 4, 5, 12, 13, 14, 25, 100, 777, 2000}) {
    for (const char* shape : {"volume", "line", "grid", "duplicates"}) {
      std::vector<double> points;
      for (int i = 0; i < n; ++i) {
        for (int k = 0; k < 3; ++k) {
          double value = normal(engine);
          if (shape[0] == 'l' && k > 0) value = 1.5;
          if (shape[0] == 'g') value = std::round(2 * value);
          if (shape[0] == 'd' && i >= 5) value = points[static_cast<std::size_t>(3 * (i % 5) + k)];
          points.push_back(value);
        }
      }
      const std::vector<Neighborhood> found = FindNeighborhoods(points.data(), n);
      const std::vector<double> expected = BruteForceDistances(points);
      ASSERT_EQ(found.size(), expected.size());
      for (std::size_t i = 0; i < found.size(); ++i) {
        ASSERT_NEAR(found[i].distance, expected[i], kRoundingTolerance)
            << shape << " " << n << " " << i;
        ASSERT_NEAR(found[i].frame.norm(), 1.0, kRoundingTolerance);
        ASSERT_TRUE(found[i].thickness >= 0.0 && found[i].thickness <= 1.0) << shape << " " << n;
      }
    }
  }
}

TEST(SeedTest, PointsInOneLineHaveNoPlane) {
  std::vector<double> points;
  for (int i = 0; i < 40; ++i) points.insert(points.end(), {0.5 * i, 1.0, -2.0});
  for (const Neighborhood& each : FindNeighborhoods(points.data(), 40)) {
    EXPECT_EQ(each.thickness, 1.0);
    EXPECT_EQ(each.frame.w(), 1.0);
  }
}

TEST(SeedTest, NeighborhoodsHaveSameBitsOnAnyThreadCount) {
  std::mt19937_64 engine(4);
  std::normal_distribution<double> normal;
  std::vector<double> points(3 * 10000);
  for (double& value : points) value = normal(engine);
  std::vector<std::vector<double>> results;
  for (const int threads : {1, 2, 8}) {
    SetNumThreads(threads);
    std::vector<double>& bits = results.emplace_back();
    for (const Neighborhood& each : FindNeighborhoods(points.data(), 10000)) {
      const auto& turn = each.frame.coeffs();
      bits.insert(bits.end(), {each.distance, each.thickness, turn[0], turn[1], turn[2], turn[3]});
    }
  }
  SetNumThreads(0);
  EXPECT_EQ(results[0], results[1]);
  EXPECT_EQ(results[0], results[2]);
}

}  // namespace
}  // namespace gsut
