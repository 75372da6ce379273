// How far a rendered image is from its photograph, pixel by pixel.
#pragma once

#include <cmath>
#include <cstdint>

#include "gsut/loss/photometric.h"

namespace gsut {

// A channel of the photograph in its light, at one of its values i = 3 pixel + channel.
inline float LitValue(const PhotometricTarget& target, std::int64_t i) {
  float value = target.byte_image() != nullptr ? static_cast<float>(target.byte_image()[i]) / 255.0f
                                               : target.float_image()[i];
  value *= target.inverse_gain()[static_cast<std::size_t>(i % 3)];
  return target.inverse_falloff() == nullptr ? value : value * target.inverse_falloff()[i];
}

// Writes the mean absolute difference of the channels (H, W) between an image (H, W, 3) and the
// photograph in its light, each channel at the brightness that fits the image best: what the light
// alone does is no error. 0 where a pixel does not count, be it that it is masked or that the loss'
// gradient (H, W, 3) was taken from it. The same bits on any number of threads.
void PixelErrors(const PhotometricTarget& target, const float* image, const float* gradient,
                 float* errors);

}  // namespace gsut
