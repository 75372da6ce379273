// The photometric loss in double, window by window.
#include "gsut/loss/reference.h"

#include <algorithm>
#include <cmath>

namespace gsut {
namespace {

constexpr std::int64_t kChannels = 3;

// The 11 x 11 pixels around one, as far as they lie in image and mask; no separable blur here.
struct Window {
  const std::uint8_t* mask;
  std::int64_t height, width, row, column;

  // Calls visit(offset of the pixel, weight) for every unmasked pixel of the window.
  template <class Visit>
  void ForEach(const Visit& visit) const {
    const auto& weights = SsimWeights();
    for (int dy = -kSsimRadius; dy <= kSsimRadius; ++dy) {
      for (int dx = -kSsimRadius; dx <= kSsimRadius; ++dx) {
        const std::int64_t y = row + dy, x = column + dx;
        if (y < 0 || y >= height || x < 0 || x >= width) continue;
        if (mask != nullptr && mask[y * width + x] == 0) continue;
        visit(y * width + x, weights[static_cast<std::size_t>(dy + kSsimRadius)] *
                                 weights[static_cast<std::size_t>(dx + kSsimRadius)]);
      }
    }
  }
};

// SSIM of one window and channel; adds factor * dSSIM/dimage to the gradient unless it is null.
double WindowSsim(const Window& window, double scale, const double* target, const double* image,
                  std::int64_t channel, double factor, double* gradient) {
  double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
  window.ForEach([&](std::int64_t pixel, double weight) {
    const double x = image[pixel * kChannels + channel], y = target[pixel * kChannels + channel];
    mx += scale * weight * x;
    my += scale * weight * y;
    xx += scale * weight * x * x;
    yy += scale * weight * y * y;
    xy += scale * weight * x * y;
  });
  const double l_top = 2 * mx * my + kSsimC1, l_bottom = mx * mx + my * my + kSsimC1;
  const double s_top = 2 * (xy - mx * my) + kSsimC2;
  const double s_bottom = (xx - mx * mx) + (yy - my * my) + kSsimC2;
  const double ssim = (l_top / l_bottom) * (s_top / s_bottom);
  if (gradient == nullptr) return ssim;
  // SSIM = l s, l = (2 mx my + C1) / (mx^2 + my^2 + C1), s = (2 sxy + C2) / (sxx + syy + C2), where
  // sxx = xx - mx^2 and sxy = xy - mx my: the means act through both factors. By the quotient's
  // rule:
  const double to_mx = 2 * my * (s_top - l_top) / (l_bottom * s_bottom) +
                       2 * mx * ssim * (1 / s_bottom - 1 / l_bottom);
  const double to_xx = -ssim / s_bottom;
  const double to_xy = 2 * l_top / (l_bottom * s_bottom);
  // Each pixel x of the window moves mx by its weight, xx by 2 x and xy by y times as much.
  window.ForEach([&](std::int64_t pixel, double weight) {
    const std::int64_t at = pixel * kChannels + channel;
    gradient[at] += factor * scale * weight * (to_mx + 2 * image[at] * to_xx + target[at] * to_xy);
  });
  return ssim;
}

}  // namespace

// Window by window: 121 pixels for each pixel and channel, in one thread and one order. What the
// kernels are compared with; it shares only the window's weights and scale with them.
PhotometricValue PhotometricLossReference(const double* target, const double* image,
                                          const std::uint8_t* mask, std::int64_t height,
                                          std::int64_t width, WindowRule rule, double ssim_weight,
                                          double* gradient) {
  const auto pixels = static_cast<double>(CountPixels(mask, height, width));
  const WindowScale scale = MakeWindowScale(mask, height, width, rule);
  const double l1_count = kChannels * pixels;
  const double ssim_count = kChannels * static_cast<double>(scale.pixels);
  if (gradient != nullptr) std::fill_n(gradient, height * width * kChannels, 0.0);
  PhotometricValue value;
  for (std::int64_t row = 0; row < height; ++row) {
    for (std::int64_t column = 0; column < width; ++column) {
      const std::int64_t pixel = row * width + column;
      if (mask != nullptr && mask[pixel] == 0) continue;
      for (std::int64_t channel = 0; channel < kChannels; ++channel) {
        const std::int64_t at = pixel * kChannels + channel;
        const double difference = image[at] - target[at];
        value.l1 += std::abs(difference) / l1_count;
        if (gradient != nullptr && difference != 0.0) {
          gradient[at] += std::copysign((1.0 - ssim_weight) / l1_count, difference);
        }
        if (scale.At(row, column) == 0.0) continue;
        const double ssim = WindowSsim({mask, height, width, row, column}, scale.At(row, column),
                                       target, image, channel, -ssim_weight / ssim_count, gradient);
        value.dssim += (1.0 - ssim) / ssim_count;
      }
    }
  }
  value.loss = (1.0 - ssim_weight) * value.l1 + ssim_weight * value.dssim;
  return value;
}

}  // namespace gsut
