// Tests gsut/loss: the double reference by differences, every kernel against it, masks.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"
#include "gsut/base/rng.h"
#include "gsut/loss/photometric.h"
#include "gsut/loss/reference.h"

namespace gsut {
namespace {

// Derived, for a loss that hangs on a single window: variances are differences of numbers up to
// 0.25 with a relative error of 2^-24 each, divided by at least C2: 2^-24 * 0.25 / C2. Observed
// 9.3e-6 (one-pixel windows, renormalised by 14).
constexpr double kSingleWindowError = 1.7e-5;
// Observed where the mean runs over 30 pixels or more: loss 2.7e-7, gradient 1.04e-6.
constexpr std::int64_t kManyPixels = 30;
constexpr double kLossRelativeError = 5e-7;
constexpr double kGradientRelativeError = 2e-6;
// Central differences with step 1e-5 of a loss with third derivatives up to 1e6 (C2 = 9e-4) per
// pixel count; observed 1.2e-8.
constexpr double kDifferenceStep = 1e-5;
constexpr double kDifferenceError = 1e-7;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

struct Case {
  std::string name;
  std::int64_t height, width;
  std::vector<double> target, image;  // (H, W, 3)
  std::vector<std::uint8_t> mask;     // empty: none

  const std::uint8_t* Mask() const { return mask.empty() ? nullptr : mask.data(); }
  std::vector<float> TargetFloats() const { return {target.begin(), target.end()}; }
  std::vector<float> ImageFloats() const { return {image.begin(), image.end()}; }
};

enum class MaskKind { kNone, kCircle, kRandom, kOnePixel };

// A smooth target with texture, rounded to 8 bits, and an image that differs from it by `noise`.
Case MakeCase(std::int64_t height, std::int64_t width, MaskKind kind, double noise) {
  Case c{"", height, width, {}, {}, {}};
  c.name = std::to_string(height) + "x" + std::to_string(width) + " mask " +
           std::to_string(static_cast<int>(kind)) + " noise " + std::to_string(noise);
  const Rng rng(11, static_cast<std::uint64_t>(height * 1000 + width));
  for (std::int64_t i = 0; i < height * width * 3; ++i) {
    const std::int64_t row = i / (3 * width), column = i / 3 % width;
    const double y = static_cast<double>(row), x = static_cast<double>(column);
    const double texture = 0.2 * (rng.Uniform(static_cast<std::uint64_t>(i)) - 0.5);
    const double smooth =
        0.5 + 0.4 * std::sin(0.07 * x + 0.3 * static_cast<double>(i % 3)) * std::cos(0.05 * y);
    // As floats, so that kernel and reference read the same numbers.
    const double value =
        static_cast<float>(std::clamp(std::round(255 * (smooth + texture)) / 255, 0.0, 1.0));
    c.target.push_back(value);
    c.image.push_back(static_cast<float>(
        value + noise * rng.Normals(static_cast<std::uint64_t>(i) + (1ull << 40))[0]));
  }
  if (kind == MaskKind::kNone) return c;
  for (std::int64_t p = 0; p < height * width; ++p) {
    const std::int64_t row = p / width, column = p % width;
    const double dy = (static_cast<double>(row) + 0.5) / static_cast<double>(height) - 0.5;
    const double dx = (static_cast<double>(column) + 0.5) / static_cast<double>(width) - 0.5;
    bool counts = p == height * width / 2;
    if (kind == MaskKind::kCircle) counts = counts || dx * dx + dy * dy < 0.23;
    if (kind == MaskKind::kRandom) {
      counts = counts || rng.Uniform(static_cast<std::uint64_t>(p) + (1ull << 50)) < 0.8;
    }
    c.mask.push_back(counts ? 255 : 0);
  }
  return c;
}

std::vector<Case> Cases() {
  std::vector<Case> cases;
  const std::int64_t sizes[][2] = {{1, 1}, {5, 7}, {11, 11}, {12, 30}, {67, 29}, {70, 530}};
  for (const auto& size : sizes) {
    for (const MaskKind kind :
         {MaskKind::kNone, MaskKind::kCircle, MaskKind::kRandom, MaskKind::kOnePixel}) {
      cases.push_back(MakeCase(size[0], size[1], kind, 0.1));
    }
  }
  cases.push_back(MakeCase(40, 40, MaskKind::kCircle, 1e-3));
  return cases;
}

double RelativeError(const std::vector<float>& got, const std::vector<double>& expected) {
  double error = 0.0, norm = 0.0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    error += (got[i] - expected[i]) * (got[i] - expected[i]);
    norm += expected[i] * expected[i];
  }
  return std::sqrt(error / norm);
}

TEST(ReferenceTest, GradientMatchesCentralDifferences) {
  int checked = 0;
  for (const WindowRule rule : {WindowRule::kPartial, WindowRule::kValid}) {
    for (const MaskKind kind : {MaskKind::kNone, MaskKind::kRandom, MaskKind::kCircle}) {
      for (const auto& size : {std::pair{16, 14}, std::pair{4, 9}}) {
        Case c = MakeCase(size.first, size.second, kind, 0.1);
        const auto loss = [&](double* gradient) {
          return PhotometricLossReference(c.target.data(), c.image.data(), c.Mask(), c.height,
                                          c.width, rule, 0.6, gradient)
              .loss;
        };
        std::vector<double> gradient(c.image.size());
        loss(gradient.data());
        double error = 0.0, norm = 0.0;
        for (std::size_t i = 0; i < c.image.size(); i += 5) {
          if (std::abs(c.image[i] - c.target[i]) < 10 * kDifferenceStep) continue;  // kink of L1
          const double kept = c.image[i];
          c.image[i] = kept + kDifferenceStep;
          const double above = loss(nullptr);
          c.image[i] = kept - kDifferenceStep;
          const double below = loss(nullptr);
          c.image[i] = kept;
          const double difference = (above - below) / (2 * kDifferenceStep);
          error += (gradient[i] - difference) * (gradient[i] - difference);
          norm += gradient[i] * gradient[i];
        }
        EXPECT_LT(std::sqrt(error / norm), kDifferenceError) << c.name;
        ++checked;
      }
    }
  }
  EXPECT_EQ(checked, 12);
}

TEST(PhotometricLossTest, EveryIsaMatchesTheReference) {
  const std::vector<std::string> isas = AvailableIsas();
  double worst_loss = 0.0, worst_gradient = 0.0;
  for (const Case& c : Cases()) {
    for (const WindowRule rule : {WindowRule::kPartial, WindowRule::kValid}) {
      std::vector<double> expected(c.image.size());
      const PhotometricValue reference = PhotometricLossReference(
          c.target.data(), c.image.data(), c.Mask(), c.height, c.width, rule, 0.2, expected.data());
      const std::vector<float> target_floats = c.TargetFloats(), image = c.ImageFloats();
      for (const std::string& isa : isas) {
        SetIsa(isa);
        const PhotometricTarget target(target_floats.data(), c.height, c.width, c.Mask(),
                                       {rule, false});
        std::vector<float> gradient(c.image.size(), -1.0f);
        const PhotometricValue value = PhotometricLoss(target, image.data(), 0.2, gradient.data());
        const double error = std::abs(value.loss - reference.loss) / reference.loss;
        const bool many = target.pixels() >= kManyPixels;
        EXPECT_LT(error, many ? kLossRelativeError : kSingleWindowError) << c.name << " " << isa;
        const double gradient_error = RelativeError(gradient, expected);
        EXPECT_LT(gradient_error, many ? kGradientRelativeError : kSingleWindowError)
            << c.name << " " << isa;
        if (many) worst_loss = std::max(worst_loss, error);
        if (many) worst_gradient = std::max(worst_gradient, gradient_error);
        EXPECT_EQ(PhotometricLoss(target, image.data(), 0.2, nullptr).loss, value.loss);
      }
    }
  }
  SetIsa("");
  RecordProperty("worst_loss", std::to_string(worst_loss * 1e9) + "e-9");
  RecordProperty("worst_gradient", std::to_string(worst_gradient * 1e9) + "e-9");
}

TEST(PhotometricLossTest, SameBitsOnAnyThreadCountAndWithKeptStatistics) {
  const Case c = MakeCase(150, 600, MaskKind::kCircle, 0.1);
  const std::vector<float> image = c.ImageFloats();
  std::vector<std::uint8_t> bytes;
  bytes.reserve(c.target.size());
  for (const double v : c.target) bytes.push_back(static_cast<std::uint8_t>(std::lround(v * 255)));
  std::vector<float> first;
  double first_loss = 0.0;
  int runs = 0;
  for (const int threads : {1, 2, 8}) {
    SetNumThreads(threads);
    for (const bool keep : {false, true}) {
      const PhotometricTarget target(bytes.data(), c.height, c.width, c.Mask(),
                                     {WindowRule::kPartial, keep});
      EXPECT_EQ(target.mean() != nullptr, keep);
      std::vector<float> gradient(c.image.size());
      const double loss = PhotometricLoss(target, image.data(), 0.2, gradient.data()).loss;
      if (runs++ == 0) {
        first = gradient;
        first_loss = loss;
      }
      EXPECT_EQ(loss, first_loss);
      EXPECT_EQ(gradient, first);
    }
  }
  SetNumThreads(0);
  EXPECT_EQ(runs, 6);
}

TEST(PhotometricLossTest, MaskedPixelsMayHoldAnythingAndGetNoGradient) {
  const Case c = MakeCase(60, 50, MaskKind::kCircle, 0.1);
  std::vector<float> target = c.TargetFloats(), image = c.ImageFloats();
  std::vector<float> clean(image.size()), dirty(image.size(), 7.0f);
  const double loss = PhotometricLoss(PhotometricTarget(target.data(), 60, 50, c.Mask()),
                                      image.data(), 0.2, clean.data())
                          .loss;
  int masked = 0;
  for (std::size_t i = 0; i < image.size(); ++i) {
    if (c.mask[i / 3] != 0) continue;
    target[i] = image[i] = static_cast<float>(kNan);
    EXPECT_EQ(clean[i], 0.0f);
    ++masked;
  }
  EXPECT_GT(masked, 100);
  EXPECT_EQ(PhotometricLoss(PhotometricTarget(target.data(), 60, 50, c.Mask()), image.data(), 0.2,
                            dirty.data())
                .loss,
            loss);
  EXPECT_EQ(dirty, clean);
}

}  // namespace
}  // namespace gsut
