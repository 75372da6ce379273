// PSNR and SSIM in double, by bands of rows.
#include "gsut/loss/metrics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"

namespace gsut {
namespace {

constexpr std::int64_t kRowsPerChunk = 32;
constexpr std::int64_t kChannels = 3;
constexpr int kMoments = 5;  // a, b, a^2, b^2, ab

// SSIM compares, in a window around each pixel, means, variances and the covariance of two images.
// All follow from five moments, each blurred by the window: along rows first, then down columns.

// Horizontally blurred moments of one row, each (W, 3); masked pixels count as 0. padded: scratch
// of kMoments rows with kSsimRadius pixels of zeros on both sides.
void BlurRow(const double* a, const double* b, const std::uint8_t* mask, std::int64_t width,
             std::vector<double>& padded, double* moments) {
  const auto& weights = SsimWeights();
  const std::int64_t length = width * kChannels;
  const std::int64_t stride = (width + 2 * kSsimRadius) * kChannels;
  for (std::int64_t i = 0; i < length; ++i) {
    const bool counts = mask == nullptr || mask[i / kChannels] != 0;
    const double x = counts ? a[i] : 0.0, y = counts ? b[i] : 0.0;
    const double values[kMoments] = {x, y, x * x, y * y, x * y};
    for (int m = 0; m < kMoments; ++m) {
      padded[static_cast<std::size_t>(m * stride + kSsimRadius * kChannels + i)] = values[m];
    }
  }
  for (int m = 0; m < kMoments; ++m) {
    double* const out = moments + m * length;
    std::fill_n(out, length, 0.0);
    for (int t = 0; t < kSsimWindow; ++t) {
      const double weight = weights[static_cast<std::size_t>(t)];
      const double* const in = padded.data() + m * stride + t * kChannels;
      for (std::int64_t i = 0; i < length; ++i) out[i] += weight * in[i];
    }
  }
}

// SSIM = (2 ma mb + C1) (2 cov + C2) / ((ma^2 + mb^2 + C1) (va + vb + C2)), Wang et al. (2004),
// equation 13, with variances as E[x^2] - E[x]^2: in double what cancels there is harmless. stride:
// from one moment to the next; scale: of the window, see ssim_window.cpp.
double SsimFromMoments(const double* moments, std::int64_t stride, double scale) {
  const double ma = scale * moments[0], mb = scale * moments[stride];
  const double va = scale * moments[2 * stride] - ma * ma;
  const double vb = scale * moments[3 * stride] - mb * mb;
  const double cov = scale * moments[4 * stride] - ma * mb;
  return (2 * ma * mb + kSsimC1) * (2 * cov + kSsimC2) /
         ((ma * ma + mb * mb + kSsimC1) * (va + vb + kSsimC2));
}

}  // namespace

// PSNR = -10 log10(MSE) for values in [0, 1], with MSE the weighted mean over pixels and channels.
// Images may leave [0, 1]: nothing is clamped.
double Psnr(const double* a, const double* b, const std::uint8_t* mask, const double* weights,
            std::int64_t height, std::int64_t width) {
  CountPixels(mask, height, width);
  CheckGiven(a, "a");
  CheckGiven(b, "b");
  const auto weight_of = [&](std::int64_t pixel) {
    if (mask != nullptr && mask[pixel] == 0) return 0.0;
    return weights == nullptr ? 1.0 : weights[pixel];
  };
  // The weights first: their sum is what the squares are divided by, and checks them all.
  const double total =
      ParallelSum(height, kRowsPerChunk, [&](std::int64_t begin, std::int64_t end) {
        double sum = 0.0;
        for (std::int64_t pixel = begin * width; pixel < end * width; ++pixel) {
          const double weight = weight_of(pixel);
          sum += weight >= 0.0 ? weight : std::numeric_limits<double>::quiet_NaN();
        }
        return sum;
      });
  // Written so that NaN fails.
  if (!(total > 0.0 && total < std::numeric_limits<double>::infinity())) {
    throw InputError("the sum of the pixel weights is " + std::to_string(total) +
                     "; give finite weights >= 0, not all 0 where the mask counts");
  }
  const double squares =
      ParallelSum(height, kRowsPerChunk, [&](std::int64_t begin, std::int64_t end) {
        double sum = 0.0;
        for (std::int64_t pixel = begin * width; pixel < end * width; ++pixel) {
          const double weight = weight_of(pixel);
          if (weight == 0.0) continue;  // masked pixels may hold NaN
          for (std::int64_t c = 0; c < kChannels; ++c) {
            const double difference = a[pixel * kChannels + c] - b[pixel * kChannels + c];
            sum += weight * difference * difference;
          }
        }
        return sum;
      });
  const double mse = squares / (kChannels * total);
  return mse == 0.0 ? std::numeric_limits<double>::infinity() : -10.0 * std::log10(mse);
}

double Ssim(const double* a, const double* b, const std::uint8_t* mask, std::int64_t height,
            std::int64_t width, WindowRule rule) {
  CountPixels(mask, height, width);
  CheckGiven(a, "a");
  CheckGiven(b, "b");
  const WindowScale scale = MakeWindowScale(mask, height, width, rule);
  const auto& weights = SsimWeights();
  const std::int64_t length = width * kChannels;
  const std::int64_t row_size = kMoments * length;
  const double sum = ParallelSum(height, kRowsPerChunk, [&](std::int64_t begin, std::int64_t end) {
    // A chunk blurs the rows of its windows along themselves, 5 beyond it on each side, and then
    // each of its own rows down the columns: 11 + 11 taps in place of 121.
    const std::int64_t first = std::max<std::int64_t>(0, begin - kSsimRadius);
    const std::int64_t last = std::min(height, end + kSsimRadius);
    std::vector<double> padded(
        static_cast<std::size_t>(kMoments * (width + 2 * kSsimRadius) * kChannels));
    std::vector<double> blurred(static_cast<std::size_t>((last - first) * row_size));
    for (std::int64_t row = first; row < last; ++row) {
      BlurRow(a + row * length, b + row * length, mask == nullptr ? nullptr : mask + row * width,
              width, padded, blurred.data() + (row - first) * row_size);
    }
    std::vector<double> moments(static_cast<std::size_t>(row_size));
    double chunk_sum = 0.0;
    for (std::int64_t row = begin; row < end; ++row) {
      std::fill(moments.begin(), moments.end(), 0.0);
      for (std::int64_t q = std::max(first, row - kSsimRadius);
           q <= std::min(last - 1, row + kSsimRadius); ++q) {
        const double weight = weights[static_cast<std::size_t>(q - row + kSsimRadius)];
        const double* const in = blurred.data() + (q - first) * row_size;
        for (std::int64_t i = 0; i < row_size; ++i) {
          moments[static_cast<std::size_t>(i)] += weight * in[i];
        }
      }
      for (std::int64_t i = 0; i < length; ++i) {
        const double window_scale = scale.At(row, i / kChannels);
        if (window_scale > 0.0) {
          chunk_sum += SsimFromMoments(moments.data() + i, length, window_scale);
        }
      }
    }
    return chunk_sum;
  });
  return sum / (kChannels * static_cast<double>(scale.pixels));
}

}  // namespace gsut
