// Image metrics in double: PSNR and SSIM of unmasked pixels.
#pragma once

#include <cstdint>

#include "gsut/loss/ssim_window.h"

namespace gsut {

// 10 log10(1 / MSE) in dB over the unmasked pixels and channels; infinite for equal images.
// a, b: (H, W, 3) with peak 1. mask: (H, W), non-zero where a pixel counts, or null.
// weights: (H, W) >= 0, the weight of each pixel in the MSE, or null for equal weights.
// Throws InputError: no pixels, a mask or weights that leave none, weights negative or not finite.
double Psnr(const double* a, const double* b, const std::uint8_t* mask, const double* weights,
            std::int64_t height, std::int64_t width);

// Mean SSIM over the pixels that the rule averages and the channels, 11 x 11 Gaussian window of
// sigma 1.5. Arguments and errors as for Psnr.
// Source: Wang, Bovik, Sheikh, Simoncelli, IEEE TIP 2004, equation 13, alpha = beta = gamma = 1.
double Ssim(const double* a, const double* b, const std::uint8_t* mask, std::int64_t height,
            std::int64_t width, WindowRule rule = WindowRule::kValid);

}  // namespace gsut
