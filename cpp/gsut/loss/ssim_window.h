// The SSIM window and the rules that say which pixels a masked SSIM averages over.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace gsut {

// Constants of SSIM for values in [0, 1]. Source: Wang, Bovik, Sheikh, Simoncelli, "Image quality
// assessment: from error visibility to structural similarity", IEEE TIP 2004, section III.
inline constexpr int kSsimRadius = 5;
inline constexpr int kSsimWindow = 2 * kSsimRadius + 1;  // pixels
inline constexpr double kSsimSigma = 1.5;                // pixels
inline constexpr double kSsimC1 = 0.01 * 0.01;
inline constexpr double kSsimC2 = 0.03 * 0.03;

// The 1D Gaussian, normalised to sum 1; the window is its outer product. [kSsimRadius] is the
// centre.
const std::array<double, kSsimWindow>& SsimWeights();

// Which windows count, and how they see the mask. Where the whole window lies inside the image and
// the mask both rules are the same number.
//   kPartial  every unmasked pixel; its window is cut to the unmasked pixels of the image and
//             renormalised to sum 1. Reaches the rim of a fisheye's circle: the rule for training.
//   kValid    only pixels whose whole window lies inside image and mask ("valid padding"): the
//             rule for published figures. Without any such pixel (images smaller than the window,
//             thin masks) it falls back to kPartial, so that SSIM always has a value.
enum class WindowRule { kPartial, kValid };

// "partial" or "valid"; throws InputError on any other name.
WindowRule ParseWindowRule(const std::string& name);
const char* WindowRuleName(WindowRule rule);

// Per pixel p the factor 1 / (sum of window weights on unmasked pixels), or 0 if p is not averaged.
// Without a mask it is the product rows[y] * columns[x] and `plane` is empty.
struct WindowScale {
  WindowRule rule = WindowRule::kPartial;  // after the fallback
  std::int64_t pixels = 0;                 // averaged over (scale > 0), > 0
  std::vector<double> plane;               // (H, W), with a mask only
  std::vector<double> rows;                // (H,), without a mask only
  std::vector<double> columns;             // (W,), without a mask only

  double At(std::int64_t y, std::int64_t x) const {
    if (plane.empty())
      return rows[static_cast<std::size_t>(y)] * columns[static_cast<std::size_t>(x)];
    return plane[static_cast<std::size_t>(y) * width + static_cast<std::size_t>(x)];
  }
  std::size_t width = 0;
};

// mask: (H, W), non-zero where a pixel counts, or null. The mask must not be empty.
WindowScale MakeWindowScale(const std::uint8_t* mask, std::int64_t height, std::int64_t width,
                            WindowRule rule);

// Number of unmasked pixels. Throws InputError if the image has no pixel or the mask leaves none.
std::int64_t CountPixels(const std::uint8_t* mask, std::int64_t height, std::int64_t width);

}  // namespace gsut
