// Draws small samples of different indices, and says how many samples RANSAC needs.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "gsut/base/rng.h"

namespace gsut {

// Sample number `draw` of kSize different indices below count (count >= kSize): a function of the
// generator and the number only.
template <int kSize>
std::array<int, kSize> DrawSample(const Rng& rng, std::uint64_t draw, int count) {
  std::array<int, kSize> sample = {};
  std::array<std::uint32_t, 4> words = {};
  std::uint64_t block = draw << 8;  // up to 256 blocks of four numbers a sample
  int used = 4;
  for (int i = 0; i < kSize;) {
    if (used == 4) {
      words = rng.Words(block++);
      used = 0;
    }
    sample[i] = static_cast<int>(
        static_cast<std::uint64_t>(words[used++]) * static_cast<std::uint64_t>(count) >> 32);
    if (std::find(sample.begin(), sample.begin() + i, sample[i]) == sample.begin() + i) ++i;
  }
  return sample;
}

// Samples after which, with probability 0.9999, one of them held inliers only.
inline int SamplesNeeded(double inlier_share, int sample_size, int most) {
  constexpr double kLogMiss = -9.210340371976182;  // log(1 - 0.9999)
  const double all_inliers = std::pow(inlier_share, sample_size);
  if (!(all_inliers > 0.0)) return most;
  if (all_inliers >= 1.0) return 1;
  const double needed = kLogMiss / std::log1p(-all_inliers);
  return needed < most ? static_cast<int>(needed) + 1 : most;
}

}  // namespace gsut
