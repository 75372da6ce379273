// Compares a rendered image with its photograph: sums from which exposure and falloff follow.
#pragma once

#include <cstdint>

#include "gsut/loss/photometric.h"

namespace gsut {

// Sums over pixels of one bin, by channel: of T C and of C^2, with T the photograph's value
// (without `SetLight`) and C the image's. T = g C has the least-squares solution g = tc / cc.
struct LightSums {
  double tc[3] = {}, cc[3] = {};
};

// Over unmasked pixels of every fourth row (of high images of fewer, 40 to 79 in all), where the
// photograph is neither black nor saturated in any channel. bins: (H, W), each below num_bins, such
// as a ring of field angle; null: all 0. sums: (num_bins), overwritten. The same bits on any number
// of threads. Throws InputError if a bin is not below num_bins.
void SumLight(const PhotometricTarget& target, const float* image, const std::uint8_t* bins,
              int num_bins, LightSums* sums);

}  // namespace gsut
