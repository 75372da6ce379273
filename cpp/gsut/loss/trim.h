// Keeps what only one photograph shows, such as a passer-by, out of the gradient.
#pragma once

#include <cstdint>

#include "gsut/loss/photometric.h"

namespace gsut {

struct TrimOptions {
  double over_median = 5.0;  // a pixel differs if its error is this many times the view's median
  int radius = 7;            // pixels; the neighbourhood is a square of 2 radius + 1
  double share = 0.5;        // of the neighbourhood that must differ
};

// Sets the gradient (H, W, 3) to zero at pixels in whose neighbourhood most pixels differ: edges
// that are not sharp yet are thin, what does not belong to the scene covers an area. Returns the
// number of pixels. image: (H, W, 3). The same bits on any number of threads. Source: Sabour et
// al., "RobustNeRF", 2023, section 3.3, with the median for its quantile.
std::int64_t TrimGradient(const PhotometricTarget& target, const float* image,
                          const TrimOptions& options, float* gradient);

}  // namespace gsut
