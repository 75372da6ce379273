// Interface between the photometric loss and its vector kernels: one block of rows and columns.
#pragma once

#include <cstdint>

#include "gsut/loss/photometric.h"

namespace gsut {

// Rows and columns of the image that one call covers.
struct ImageBlock {
  std::int64_t row_begin = 0, row_end = 0;
  std::int64_t column_begin = 0, column_end = 0;
};

struct BlockSums {
  double absolute = 0.0;  // sum of |image - target| of unmasked pixels and channels
  double dssim = 0.0;     // sum of 1 - SSIM of averaged pixels and channels
};

// Sums of one block; with a gradient also dloss_dimage of the block's pixels, where l1_factor and
// dssim_factor are the derivatives of the loss to the two sums.
BlockSums PhotometricBlock(const PhotometricTarget& target, const float* image,
                           const ImageBlock& block, float l1_factor, float dssim_factor,
                           float* gradient);

// Mean and variance of the target (minus 0.5) in the SSIM window for one block, written into
// (H, W, 3) planes. The target's own statistics are not read.
void TargetStatisticsBlock(const PhotometricTarget& target, const ImageBlock& block, float* mean,
                           float* variance);

}  // namespace gsut
