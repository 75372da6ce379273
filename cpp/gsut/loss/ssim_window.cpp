// Weights of the SSIM window and their renormalisation at the borders of image and mask.
#include "gsut/loss/ssim_window.h"

#include <algorithm>
#include <cmath>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"

namespace gsut {
namespace {

constexpr std::int64_t kRowsPerChunk = 32;

// A window that reaches over the border of image or mask is cut there; its moments are multiplied
// by scale = 1 / (the weights that are left), so that they are means again. Scale 0 leaves the
// pixel out. Without a mask the cut window is still a product, and so is the scale: rows x columns.

// Scale along one axis without a mask: the part of the 1D window that lies inside [0, length).
std::vector<double> AxisScale(std::int64_t length, WindowRule rule) {
  const auto& weights = SsimWeights();
  std::vector<double> scale(static_cast<std::size_t>(length));
  for (std::int64_t i = 0; i < length; ++i) {
    const bool whole = i >= kSsimRadius && i + kSsimRadius < length;
    double sum = 0.0;
    for (int t = -kSsimRadius; t <= kSsimRadius; ++t) {
      if (i + t >= 0 && i + t < length) sum += weights[static_cast<std::size_t>(t + kSsimRadius)];
    }
    const double partial = rule == WindowRule::kPartial ? 1.0 / sum : 0.0;
    scale[static_cast<std::size_t>(i)] = whole ? 1.0 : partial;
  }
  return scale;
}

// Scale per pixel under a mask, by a horizontal and a vertical pass over the rows of a chunk.
void FillMaskedScale(const std::uint8_t* mask, std::int64_t height, std::int64_t width,
                     WindowRule rule, double* plane) {
  const auto& weights = SsimWeights();
  ParallelFor(height, kRowsPerChunk, [&](std::int64_t begin, std::int64_t end) {
    const std::int64_t first = std::max<std::int64_t>(0, begin - kSsimRadius);
    const std::int64_t last = std::min(height, end + kSsimRadius);
    const std::size_t cells = static_cast<std::size_t>((last - first) * width);
    std::vector<double> sums(cells);
    std::vector<int> counts(cells);
    for (std::int64_t y = first; y < last; ++y) {
      // Along the row: weights and number of unmasked pixels.
      for (std::int64_t x = 0; x < width; ++x) {
        double sum = 0.0;
        int count = 0;
        const std::int64_t left = std::max<std::int64_t>(0, x - kSsimRadius);
        const std::int64_t right = std::min(width - 1, x + kSsimRadius);
        for (std::int64_t q = left; q <= right; ++q) {
          if (mask[y * width + q] == 0) continue;
          sum += weights[static_cast<std::size_t>(q - x + kSsimRadius)];
          ++count;
        }
        sums[static_cast<std::size_t>((y - first) * width + x)] = sum;
        counts[static_cast<std::size_t>((y - first) * width + x)] = count;
      }
    }
    for (std::int64_t y = begin; y < end; ++y) {
      // Down the columns of these sums: those of the whole window.
      for (std::int64_t x = 0; x < width; ++x) {
        double sum = 0.0;
        int count = 0;
        const std::int64_t top = std::max(first, y - kSsimRadius);
        const std::int64_t bottom = std::min(last - 1, y + kSsimRadius);
        for (std::int64_t q = top; q <= bottom; ++q) {
          const std::size_t cell = static_cast<std::size_t>((q - first) * width + x);
          sum += weights[static_cast<std::size_t>(q - y + kSsimRadius)] * sums[cell];
          count += counts[cell];
        }
        double scale = 0.0;
        if (mask[y * width + x] != 0) {
          // Whole windows have exactly 1, whatever the rounding of the sum.
          if (count == kSsimWindow * kSsimWindow) {
            scale = 1.0;
          } else if (rule == WindowRule::kPartial) {
            scale = 1.0 / sum;
          }
        }
        plane[y * width + x] = scale;
      }
    }
  });
}

std::int64_t CountPositive(const std::vector<double>& values) {
  return std::count_if(values.begin(), values.end(), [](double value) { return value > 0.0; });
}

WindowScale TryWindowScale(const std::uint8_t* mask, std::int64_t height, std::int64_t width,
                           WindowRule rule) {
  WindowScale scale;
  scale.rule = rule;
  scale.width = static_cast<std::size_t>(width);
  if (mask == nullptr) {
    scale.rows = AxisScale(height, rule);
    scale.columns = AxisScale(width, rule);
    scale.pixels = CountPositive(scale.rows) * CountPositive(scale.columns);
  } else {
    scale.plane.resize(static_cast<std::size_t>(height * width));
    FillMaskedScale(mask, height, width, rule, scale.plane.data());
    scale.pixels = CountPositive(scale.plane);
  }
  return scale;
}

}  // namespace

// A Gaussian of sigma 1.5 pixels over 11, of sum 1 (Wang et al., 2004, section III-B); the window
// is its product with itself.
const std::array<double, kSsimWindow>& SsimWeights() {
  static const std::array<double, kSsimWindow> weights = [] {
    std::array<double, kSsimWindow> w{};
    double sum = 0.0;
    for (int t = -kSsimRadius; t <= kSsimRadius; ++t) {
      sum += w[static_cast<std::size_t>(t + kSsimRadius)] =
          std::exp(-0.5 * t * t / (kSsimSigma * kSsimSigma));
    }
    for (double& value : w) value /= sum;
    return w;
  }();
  return weights;
}

WindowRule ParseWindowRule(const std::string& name) {
  if (name == "partial") return WindowRule::kPartial;
  if (name == "valid") return WindowRule::kValid;
  throw InputError("window_rule is \"" + name + "\"; known rules: partial, valid");
}

const char* WindowRuleName(WindowRule rule) {
  return rule == WindowRule::kPartial ? "partial" : "valid";
}

// "valid" may leave no window at all, as in a narrow ring of a fisheye: then partial ones count.
WindowScale MakeWindowScale(const std::uint8_t* mask, std::int64_t height, std::int64_t width,
                            WindowRule rule) {
  WindowScale scale = TryWindowScale(mask, height, width, rule);
  if (scale.pixels == 0) scale = TryWindowScale(mask, height, width, WindowRule::kPartial);
  return scale;
}

std::int64_t CountPixels(const std::uint8_t* mask, std::int64_t height, std::int64_t width) {
  if (height < 1 || width < 1) {
    throw InputError("the image has size " + std::to_string(width) + " x " +
                     std::to_string(height) + "; give at least 1 x 1 pixels");
  }
  if (mask == nullptr) return height * width;
  const std::int64_t count =
      height * width - std::count(mask, mask + height * width, std::uint8_t{0});
  if (count == 0) {
    throw InputError(
        "the mask leaves no pixel (all zero); non-zero marks the pixels that count: is it "
        "inverted, or does this image lie outside the lens' circle?");
  }
  return count;
}

}  // namespace gsut
