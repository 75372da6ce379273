// Tests gsut/gaussians/primitive.h over the examples of every file: slopes, inverses, closed forms.
#include <gtest/gtest.h>

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

// Calls test(profile) for each example of each primitive; returns how many there were.
template <class Test>
int ForEachExample(Test&& test) {
  int ran = 0;
  for (const std::string& name : PrimitiveNames()) {
    SCOPED_TRACE(name);
    for (const double stored : ExampleShapes(PrimitiveNamed(name))) {
      SCOPED_TRACE(stored);
      test(Profile{PrimitiveNamed(name), stored});
      ++ran;
    }
  }
  return ran;
}

TEST(PrimitivesTest, NamesAreThoseOfTheFilesAndOthersAreRefused) {
  for (const std::string& name : PrimitiveNames()) {
    EXPECT_EQ(NameOf(PrimitiveNamed(name)), name);
  }
  EXPECT_FALSE(HasShape(Primitive::kGaussian));
  EXPECT_TRUE(HasShape(Primitive::kBeta));
  EXPECT_THROW(PrimitiveNamed("cube"), InputError);
}

TEST(PrimitivesTest, SlopesMatchCentralDifferences) {
  const int ran = ForEachExample([](const Profile& profile) {
    const double end = profile.Cutoff(-2.0 * std::log(kLeastResponse));
    for (const double share : {0.01, 0.3, 0.7, 0.97}) {
      const double d2 = share * end;
      const double high = std::log(profile.Response(d2 + kStep));
      const double low = std::log(profile.Response(d2 - kStep));
      const double slope = profile.Slope(d2);
      EXPECT_NEAR(-(high - low) / kStep, slope, kDifferenceTolerance * (1.0 + slope * slope));
      Profile more = profile, less = profile;
      more.stored += kStep;
      less.stored -= kStep;
      const double difference = std::log(more.Response(d2)) - std::log(less.Response(d2));
      EXPECT_NEAR(0.5 * difference / kStep, profile.StoredSlope(d2),
                  kDifferenceTolerance * (1.0 + slope * slope));
      EXPECT_NEAR(0.5 * (more.Shape() - less.Shape()) / kStep,
                  HasShape(profile.primitive) ? profile.ActivationSlope() : 1.0,
                  kDifferenceTolerance * (1.0 + profile.Shape()));
    }
  });
  EXPECT_EQ(ran, 7);
}

TEST(PrimitivesTest, ResponseFallsFromOneAndCutoffIsItsInverse) {
  const int ran = ForEachExample([](const Profile& profile) {
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
  });
  EXPECT_EQ(ran, 7);
}

TEST(PrimitivesTest, ClosedFormsHold) {
  for (const double d2 : {0.1, 1.0, 4.0, 9.0}) {
    EXPECT_NEAR((Profile{Primitive::kGaussian}).Response(d2), std::exp(-0.5 * d2),
                kRoundingTolerance);
    EXPECT_NEAR((Profile{Primitive::kPower4}).Response(d2), std::exp(-4.5 * std::pow(d2 / 9.0, 2)),
                kRoundingTolerance);
    const double beta = std::pow(std::max(1.0 - d2 / 8.0, 0.0), 4.0);
    EXPECT_NEAR((Profile{Primitive::kBeta, 0.0}).Response(d2), beta, kRoundingTolerance);
  }
}

}  // namespace
}  // namespace gsut
