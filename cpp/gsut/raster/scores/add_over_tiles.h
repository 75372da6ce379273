// Sums over the pixels of a frame, Gaussian by Gaussian, in one order on any number of threads.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gsut/base/parallel.h"
#include "gsut/raster/frame.h"

namespace gsut {

// Tiles whose sums are held at a time: memory does not grow with the image.
inline constexpr int kTilesAtATime = 64;

// tile(number, sums) leaves num_sums numbers an entry of the tile; they are added to the Gaussians'
// rows of out in the order of tiles and entries, whatever the number of threads.
template <class Number, class Tile>
void AddOverTiles(const Frame& frame, int num_tiles, int num_sums, const Tile& tile, Number* out) {
  const auto width = static_cast<std::size_t>(num_sums);
  std::vector<Number> sums;
  std::vector<std::size_t> first;
  for (int begin = 0; begin < num_tiles; begin += kTilesAtATime) {
    const int end = std::min(begin + kTilesAtATime, num_tiles);
    first.assign(1, 0);
    for (int t = begin; t < end; ++t) {
      first.push_back(first.back() + frame.entry_count[static_cast<std::size_t>(t)]);
    }
    sums.assign(first.back() * width, Number(0));
    ParallelFor(end - begin, 1, [&](std::int64_t t, std::int64_t) {
      tile(begin + static_cast<int>(t), sums.data() + first[static_cast<std::size_t>(t)] * width);
    });
    const Number* row = sums.data();
    for (int t = begin; t < end; ++t) {
      const std::size_t entry = frame.tile_begin[static_cast<std::size_t>(t)];
      for (std::size_t e = 0; e < frame.entry_count[static_cast<std::size_t>(t)]; ++e) {
        Number* to = out + std::size_t{frame.entries[entry + e].gaussian} * width;
        for (std::size_t k = 0; k < width; ++k) to[k] += *row++;
      }
    }
  }
}

}  // namespace gsut
