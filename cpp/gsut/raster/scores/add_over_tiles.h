// Sums over the pixels of a frame, Gaussian by Gaussian, in one order on any number of threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gsut/base/parallel.h"
#include "gsut/raster/frame.h"

namespace gsut {

// Tiles whose sums are held at a time, so that memory does not grow with the image; fewer where
// their sums would leave a core's cache, but enough for all threads.
inline constexpr int kTilesAtATime = 64;
inline constexpr std::size_t kSumsAtATime = std::size_t{1} << 18;
// Sums that one thread adds to the Gaussians' rows.
inline constexpr std::int64_t kSumsPart = 64;

// tile(number, sums) leaves num_sums numbers an entry of the tile; they are added to the Gaussians'
// rows of out in the order of tiles and entries, whatever the number of threads.
template <class Number, class Tile>
void AddOverTiles(const Frame& frame, int num_tiles, int num_sums, const Tile& tile, Number* out) {
  const auto width = static_cast<std::size_t>(num_sums);
  const int least = std::min(NumThreads(), kTilesAtATime);
  std::vector<Number> sums;
  std::vector<std::size_t> first;
  for (int begin = 0, end = 0; begin < num_tiles; begin = end) {
    first.assign(1, 0);
    while (end < num_tiles && end - begin < kTilesAtATime &&
           (end - begin < least || first.back() * width < kSumsAtATime)) {
      first.push_back(first.back() + frame.entry_count[static_cast<std::size_t>(end++)]);
    }
    sums.assign(first.back() * width, Number(0));
    ParallelFor(end - begin, 1, [&](std::int64_t t, std::int64_t) {
      tile(begin + static_cast<int>(t), sums.data() + first[static_cast<std::size_t>(t)] * width);
    });
    ParallelFor(num_sums, kSumsPart, [&](std::int64_t from, std::int64_t to) {
      const auto part = static_cast<std::size_t>(to - from);
      const Number* row = sums.data() + from;
      for (int t = begin; t < end; ++t) {
        const std::size_t entry = frame.tile_begin[static_cast<std::size_t>(t)];
        for (std::size_t e = 0; e < frame.entry_count[static_cast<std::size_t>(t)]; ++e) {
          Number* at = out + std::size_t{frame.entries[entry + e].gaussian} * width + from;
          for (std::size_t k = 0; k < part; ++k) at[k] += row[k];
          row += width;
        }
      }
    });
  }
}

}  // namespace gsut
