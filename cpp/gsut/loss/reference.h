// The photometric loss and its gradient in double, straight from the formulas: slow, and the truth.
#pragma once

#include <cstdint>

#include "gsut/loss/photometric.h"

namespace gsut {

// As PhotometricLoss, with the images in double and every window summed pixel by pixel.
// target, image: (H, W, 3). mask: (H, W) or null. gradient: (H, W, 3), overwritten, or null.
// Throws InputError: no pixels, a mask that leaves none.
PhotometricValue PhotometricLossReference(const double* target, const double* image,
                                          const std::uint8_t* mask, std::int64_t height,
                                          std::int64_t width, WindowRule rule, double ssim_weight,
                                          double* gradient);

}  // namespace gsut
