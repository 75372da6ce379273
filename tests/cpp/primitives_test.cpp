// Tests gsut/gaussians/primitive.h over every primitive: slopes, inverses, closed forms.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/gaussians/primitive.h"

namespace gsut {
namespace {

// Central differences with step h in double: h^2 f''' / 6 + eps / h ~ 1e-10 at h = 1e-5.
constexpr double kStep = 1e-5;
constexpr double kDifferenceTolerance = 1e-8;
// A logarithm and an exponential of numbers up to 12, in double.
constexpr double kRoundingTolerance = 1e-13;
constexpr double kLeastResponse = 1.0 / 255.0;

constexpr Profile kProfiles[] = {{Primitive::kGaussian}, {Primitive::kTriangle}};

TEST(PrimitivesTest, NamesAreReadBackAndOthersAreRefused) {
  for (const std::string& name : PrimitiveNames()) {
    EXPECT_EQ(NameOf(PrimitiveNamed(name)), name);
  }
  EXPECT_FALSE(IsFlat(Primitive::kGaussian));
  EXPECT_TRUE(IsFlat(Primitive::kTriangle));
  EXPECT_THROW(PrimitiveNamed("cube"), InputError);
}

TEST(PrimitivesTest, SlopesMatchCentralDifferences) {
  for (const Profile& profile : kProfiles) {
    SCOPED_TRACE(NameOf(profile.primitive));
    const double end = profile.Cutoff(-2.0 * std::log(kLeastResponse));
    for (const double share : {0.01, 0.3, 0.7, 0.97}) {
      const double d2 = share * end;
      const double high = std::log(profile.Response(d2 + kStep));
      const double low = std::log(profile.Response(d2 - kStep));
      const double slope = profile.Slope(d2);
      EXPECT_NEAR(-(high - low) / kStep, slope, kDifferenceTolerance * (1.0 + slope * slope));
    }
  }
}

TEST(PrimitivesTest, ResponseFallsFromOneAndCutoffIsItsInverse) {
  for (const Profile& profile : kProfiles) {
    SCOPED_TRACE(NameOf(profile.primitive));
    EXPECT_EQ(profile.Response(0.0), 1.0);
    double last = 1.0;
    for (int i = 1; i <= 12; ++i) {
      const double end = profile.Cutoff(i);
      const double response = profile.Response(end);
      EXPECT_NEAR(std::log(response), -0.5 * i,
                  kRoundingTolerance * std::exp(0.5 * i) * (1.0 + profile.Slope(end)));
      EXPECT_LT(response, last);
      last = response;
    }
  }
}

TEST(PrimitivesTest, TriangleGaugeIsTheLargestOfItsEdgesWithTheirSlopes) {
  const Profile triangle = {Primitive::kTriangle};
  for (int i = 2; i < 360; i += 7) {  // beside the ridges at 90, 210 and 330 degrees
    const double angle = i * 3.14159265358979323846 / 180.0;
    const double x = 0.7 * std::cos(angle), y = 0.7 * std::sin(angle);
    double slopes[2], ignored[2];
    const double gauge = triangle.Gauge(x, y, slopes);
    EXPECT_NEAR(gauge, std::max(-2.0 * y, std::sqrt(3.0) * std::abs(x) + y), kRoundingTolerance);
    EXPECT_GE(gauge, 0.7 - kRoundingTolerance);  // nowhere below D: bounds of ellipses hold
    EXPECT_NEAR(slopes[0] * x + slopes[1] * y, gauge, kRoundingTolerance);  // of degree 1
    const double by_x =
        triangle.Gauge(x + kStep, y, ignored) - triangle.Gauge(x - kStep, y, ignored);
    const double by_y =
        triangle.Gauge(x, y + kStep, ignored) - triangle.Gauge(x, y - kStep, ignored);
    EXPECT_NEAR(0.5 * by_x / kStep, slopes[0], kDifferenceTolerance);
    EXPECT_NEAR(0.5 * by_y / kStep, slopes[1], kDifferenceTolerance);
  }
}

// By the midpoint rule over squares of side 2 h, whose error is that of the outline and the ridges.
TEST(PrimitivesTest, TriangleHasAGaussiansSecondMomentsAndItsArea) {
  constexpr double kHalfSide = 0.02;
  constexpr double kQuadratureTolerance = 2e-3;
  const Profile triangle = {Primitive::kTriangle};
  double sum = 0.0, square_x = 0.0, square_y = 0.0, mean_y = 0.0, ignored[2];
  for (double x = -4.0 + kHalfSide; x < 4.0; x += 2.0 * kHalfSide) {
    for (double y = -2.0 + kHalfSide; y < 4.0; y += 2.0 * kHalfSide) {
      const double gauge = triangle.Gauge(x, y, ignored);
      const double response = triangle.Response(gauge * gauge);
      sum += response;
      mean_y += response * y;
      square_x += response * x * x;
      square_y += response * y * y;
    }
  }
  EXPECT_NEAR(square_x / sum, 1.0, kQuadratureTolerance);
  EXPECT_NEAR(square_y / sum, 1.0, kQuadratureTolerance);
  EXPECT_NEAR(mean_y / sum, 0.0, kQuadratureTolerance);
  // At half the response, as large as a Gaussian: a linear fall is alike to 1 %.
  EXPECT_NEAR(WidthOf(Primitive::kTriangle), 1.0, 0.01);
  EXPECT_EQ(WidthOf(Primitive::kGaussian), 1.0);
}

TEST(PrimitivesTest, ClosedFormsHold) {
  for (const double d2 : {0.1, 1.0, 4.0, 9.0}) {
    EXPECT_NEAR((Profile{Primitive::kGaussian}).Response(d2), std::exp(-0.5 * d2),
                kRoundingTolerance);
    const double linear = std::max(1.0 - std::sqrt(d2 / (40.0 / 3.0)), 0.0);
    EXPECT_NEAR((Profile{Primitive::kTriangle}).Response(d2), linear, kRoundingTolerance);
  }
}

}  // namespace
}  // namespace gsut
