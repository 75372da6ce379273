// Tests gsut/cameras: roots, domains, inverses, kernels.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "gsut/base/aligned_vector.h"
#include "gsut/base/isa.h"
#include "gsut/cameras/camera.h"
#include "gsut/cameras/lens_kernels.h"
#include "gsut/cameras/plane_inverses.h"
#include "gsut/cameras/plane_map.h"
#include "gsut/cameras/polynomial.h"

namespace gsut {
namespace {

// Relative, for roots of well-conditioned polynomials: a few units in the last place.
constexpr double kRootTolerance = 1e-14;
// Float: 24 bits of a pixel coordinate below 4096, times the few roundings of the polynomial and of
// the vector arctangent (3 units in the last place). Observed 2.7e-3, the same on every instruction
// set: fisheye624, and opencv5 with derivatives, whose quotients are products with the reciprocal.
constexpr double kFloatPixelTolerance = 4e-3;
// Float near the axis, relative to the distance from the principal point.
constexpr double kFloatAxisTolerance = 1e-6;

TEST(PolynomialTest, SmallestPositiveRootOfKnownFactors) {
  // (x - 0.25)(x - 3)(x + 2), (x - 7)(x^2 + 1), 2 - 1e-6 x.
  EXPECT_NEAR(SmallestPositiveRoot(std::vector<double>{1.5, -5.75, -1.25, 1}), 0.25,
              kRootTolerance);
  EXPECT_NEAR(SmallestPositiveRoot(std::vector<double>{-7, 1, -7, 1}), 7.0, 7 * kRootTolerance);
  EXPECT_NEAR(SmallestPositiveRoot(std::vector<double>{2, -1e-6}), 2e6, 2e6 * kRootTolerance);
}

TEST(PolynomialTest, SmallestPositiveRootWithoutRootIsInfinite) {
  EXPECT_EQ(SmallestPositiveRoot(std::vector<double>{1}), kInfinity);
  EXPECT_EQ(SmallestPositiveRoot(std::vector<double>{1, 2, 0, 3}), kInfinity);
  EXPECT_EQ(SmallestPositiveRoot(std::vector<double>{1, -1, 1, 0, 0}), kInfinity);
}

TEST(PolynomialTest, RootThatTouchesZeroCounts) {
  // (x - 0.5)^2 (x + 1); the touching root is known to the square root of epsilon.
  EXPECT_NEAR(SmallestPositiveRoot(std::vector<double>{0.25, -0.75, 0, 1}), 0.5, 1e-7);
}

TEST(PlaneMapTest, RegularRadiusOfQuadraticMapIsWhereItFolds) {
  // (x + a x^2, y): det = 1 + 2 a x vanishes at x = -1 / (2 a), first at azimuth pi.
  const PlaneMap map = [](double x, double y) {
    return PlanePoint{x + 0.25 * x * x, y, 1 + 0.5 * x, 0, 0, 1};
  };
  EXPECT_NEAR(RegularRadius(map, 100.0), 2.0, 1e-8);
  EXPECT_EQ(RegularRadius(map, 1.5), 1.5);
}

TEST(PlaneMapTest, DomainOfTangentialLensesEndsWhereTheyFold) {
  // The domain skips circles on which bounds say that the map is regular; sampling all of them must
  // find the same end. k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4; the first draws are near a radial lens.
  std::mt19937 random(7);
  std::normal_distribution<double> normal;
  int folds = 0;
  for (int draw = 0; draw < 200; ++draw) {
    const double other = std::pow(10.0, -4.0 + draw / 50.0), radial = draw % 2 == 0 ? 0.3 : 0.03;
    std::vector<double> params = {1000, 1000, 500, 500};
    for (int i = 0; i < 12; ++i) {
      const bool is_radial = i < 2 || (i >= 4 && i < 8);
      params.push_back((is_radial ? radial : other) * normal(random));
    }
    const double* c = &params[4];
    const PlaneMap map = MakePlaneMap([c](Dual<2> x, Dual<2> y, Dual<2>* u, Dual<2>* v) {
      const auto k = [c](int i) { return Dual<2>(c[i]); };
      const Dual<2> s = x * x + y * y, one(1.0), two(2.0);
      const Dual<2> g =
          (one + s * (k(0) + s * (k(1) + s * k(4)))) / (one + s * (k(5) + s * (k(6) + s * k(7))));
      *u = x * g + k(2) * two * x * y + k(3) * (s + two * x * x) + s * (k(8) + s * k(9));
      *v = y * g + k(2) * (s + two * y * y) + k(3) * two * x * y + s * (k(10) + s * k(11));
    });
    const double r = std::sqrt(RadialTangentialDomain(params.data(), 16, 1.5).limits[0]);
    const double regular = RegularRadius(map, 1.3 * r);
    EXPECT_LE(r, regular * (1 + 1e-6)) << draw;
    folds += std::abs(r - regular) < 1e-6 * r;
  }
  EXPECT_GE(folds, 50);
}

TEST(PlaneMapTest, InvertFollowsTheSegmentWhereNewtonFails) {
  // A strong odd saturation: Newton from the far side overshoots; the start makes it fail.
  const PlaneMap map = [](double x, double y) {
    const double s = 1 + x * x + y * y;
    const double g = 1 / std::sqrt(s);
    const double c = -g / s;
    return PlanePoint{x * g, y * g, g + x * x * c, x * y * c, x * y * c, g + y * y * c};
  };
  for (const double target : {0.1, 0.9, 0.999, 0.9999}) {
    double x = -50.0, y = 30.0;
    ASSERT_TRUE(InvertPlaneMap(map, 1000.0, target, 0.0, &x, &y)) << target;
    EXPECT_NEAR(map(x, y).u, target, 1e-12);
    EXPECT_NEAR(map(x, y).v, 0.0, 1e-12);
  }
  double x = 0.0, y = 0.0;
  EXPECT_FALSE(InvertPlaneMap(map, 1000.0, 1.5, 0.0, &x, &y));
  EXPECT_FALSE(ImageOfDiscContains(map, 1000.0, 1.5, 0.0));
  EXPECT_TRUE(ImageOfDiscContains(map, 1000.0, 0.5, 0.1));
}

// Pixels of points (count, 3) by the float kernel.
std::vector<double> FloatPixels(const Camera& camera, const std::vector<double>& points) {
  const std::size_t count = points.size() / 3, padded = (count + 15) / 16 * 16;
  AlignedVector<float> numbers(5 * padded);
  const auto array = [&](std::size_t k) { return &numbers[k * padded]; };
  for (std::size_t i = 0; i < padded; ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      array(k)[i] = static_cast<float>(points[3 * std::min(i, count - 1) + k]);
    }
  }
  ProjectPoints(FloatLens(camera), static_cast<int>(padded),
                {array(0), array(1), array(2), array(3), array(4)});
  std::vector<double> pixels;
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t k = 3; k < 5; ++k) pixels.push_back(array(k)[i]);
  }
  return pixels;
}

TEST(LensKernelTest, FloatMatchesDoubleOnEveryLensAndInstructionSet) {
  int lenses_run = 0, points_run = 0;
  double worst = 0.0, worst_axis = 0.0;
  const auto compare = [&](const std::string& name, const LensExample& example) {
    const Camera camera(name, {example.params, example.params + example.num_params}, example.width,
                        example.height);
    // Angles up to the corner of the image.
    std::vector<double> points;
    for (int i = -40; i < 400; ++i) {
      const double limit = std::min(camera.MaxAngle(), 1.3);
      const double angle = i < 0 ? std::pow(10.0, 0.25 * i) : 0.995 * limit * i / 400;
      points.push_back(static_cast<float>(3.0 * std::sin(angle) * 0.8));
      points.push_back(static_cast<float>(3.0 * std::sin(angle) * 0.6));
      points.push_back(static_cast<float>(3.0 * std::cos(angle)));
    }
    const double forward[3] = {0, 0, 1};
    double centre[2];
    std::uint8_t centre_valid = 0;
    camera.Project(1, forward, centre, &centre_valid);
    const std::int64_t count = static_cast<std::int64_t>(points.size() / 3);
    const auto exact_pixels = [&](const Camera& of) {
      std::vector<double> pixels(2 * points.size() / 3);
      std::vector<std::uint8_t> valid(points.size() / 3);
      of.Project(count, points.data(), pixels.data(), valid.data());
      return pixels;  // NaN where invalid
    };
    const std::vector<double> exact = exact_pixels(camera);
    const std::vector<double> found = FloatPixels(camera, points);
    for (std::size_t i = 0; i < points.size() / 3; ++i) {
      const double radius = std::hypot(exact[2 * i] - centre[0], exact[2 * i + 1] - centre[1]);
      if (!(radius <= 4096)) continue;
      const double error =
          std::hypot(found[2 * i] - exact[2 * i], found[2 * i + 1] - exact[2 * i + 1]);
      ASSERT_FALSE(std::isnan(error)) << name << " " << i;
      worst = std::max(worst, error);
      ++points_run;
    }
    if (std::string(LensParamNames(camera.lens())).starts_with("fx fy cx cy") &&
        !name.starts_with("cahvor")) {  // axes of their own
      // The offset itself, without the principal point's digits.
      std::vector<double> centred = camera.params();
      centred[2] = centred[3] = 0.0;
      const Camera centred_camera(name, centred, example.width, example.height);
      const std::vector<double> offsets = exact_pixels(centred_camera);
      const std::vector<double> found_offsets = FloatPixels(centred_camera, points);
      for (std::size_t k = 0; k < 2 * 40; k += 2) {
        worst_axis = std::max(worst_axis, std::hypot(found_offsets[k] / offsets[k] - 1.0,
                                                     found_offsets[k + 1] / offsets[k + 1] - 1.0));
      }
    }
    ++lenses_run;
  };
  for (const std::string& isa : AvailableIsas()) {
    SetIsa(isa);
    for (const std::string& name : LensNames()) {
      for (const LensExample& example : LensExamples(LensFromName(name))) compare(name, example);
    }
  }
  SetIsa("");
  EXPECT_GE(lenses_run, 10 * static_cast<int>(AvailableIsas().size()));
  EXPECT_GT(points_run, 300 * lenses_run);
  EXPECT_LT(worst, kFloatPixelTolerance);
  EXPECT_LT(worst_axis, kFloatAxisTolerance);
  std::printf("float: %.1e px, %.1e of the offset near the axis\n", worst, worst_axis);
}

}  // namespace
}  // namespace gsut
