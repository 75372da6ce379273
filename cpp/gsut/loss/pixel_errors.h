// How far a rendered image is from its photograph, pixel by pixel.
#pragma once

#include <cstdint>

#include "gsut/loss/photometric.h"

namespace gsut {

// Writes the mean absolute difference of the channels (H, W) between an image (H, W, 3) and the
// photograph in its light, each channel at the brightness that fits the image best: what the light
// alone does is no error. 0 where a pixel does not count, be it that it is masked or that the loss'
// gradient (H, W, 3) was taken from it. The same bits on any number of threads.
void PixelErrors(const PhotometricTarget& target, const float* image, const float* gradient,
                 float* errors);

}  // namespace gsut
