// Depth order by a stable radix sort, then a stable distribution of (tile, Gaussian) pairs.
#include "gsut/raster/bin_tiles.h"

#include <algorithm>
#include <bit>
#include <string>
#include <vector>

#include "gsut/base/aligned_vector.h"
#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"

namespace gsut {
namespace {

// Work is cut into at most this many parts, by size only. A part of the sort counts 2048 digits, so
// that small ones cost more than they save.
constexpr std::int64_t kMaxParts = 64;
constexpr std::int64_t kMinSortPart = 8192;
constexpr std::int64_t kMinPart = 1024;
constexpr int kRadixBits = 11;
constexpr std::uint32_t kRadix = 1u << kRadixBits;
// In depth order the Gaussians' rectangles lie anywhere: they are fetched this far ahead.
constexpr std::int64_t kFetchAhead = 16;

struct Parts {
  explicit Parts(std::int64_t n, std::int64_t least = kMinPart)
      : count(std::clamp<std::int64_t>(n / least, 1, kMaxParts)), grain((n + count - 1) / count) {
    if (grain > 0) count = (n + grain - 1) / grain;
  }
  std::int64_t count;
  std::int64_t grain;
};

// Float bits ordered as unsigned integers, negative numbers included; both zeros alike.
std::uint32_t SortableBits(float key) {
  const std::uint32_t bits = std::bit_cast<std::uint32_t>(key + 0.0f);
  return (bits & 0x80000000u) != 0 ? ~bits : bits | 0x80000000u;
}

struct Keyed {
  std::uint32_t key;
  std::uint32_t index;
};

// Stable radix sort of `items` by key, three passes of 11 bits.
void RadixSort(AlignedVector<Keyed>* items, AlignedVector<Keyed>* scratch) {
  const std::int64_t n = static_cast<std::int64_t>(items->size());
  scratch->resize(items->size());
  const Parts parts(n, kMinSortPart);
  std::vector<std::uint32_t> counts(static_cast<std::size_t>(parts.count) * kRadix);
  for (int shift = 0; shift < 32; shift += kRadixBits) {
    std::fill(counts.begin(), counts.end(), 0u);
    ParallelFor(n, parts.grain, [&](std::int64_t begin, std::int64_t end) {
      std::uint32_t* count = &counts[static_cast<std::size_t>(begin / parts.grain) * kRadix];
      for (std::int64_t i = begin; i < end; ++i) {
        ++count[((*items)[static_cast<std::size_t>(i)].key >> shift) & (kRadix - 1)];
      }
    });
    // Digit by digit, and part by part within a digit: equal keys keep their order.
    std::uint32_t sum = 0;
    for (std::uint32_t digit = 0; digit < kRadix; ++digit) {
      for (std::int64_t part = 0; part < parts.count; ++part) {
        std::uint32_t& count = counts[static_cast<std::size_t>(part) * kRadix + digit];
        const std::uint32_t here = count;
        count = sum;
        sum += here;
      }
    }
    ParallelFor(n, parts.grain, [&](std::int64_t begin, std::int64_t end) {
      std::uint32_t* position = &counts[static_cast<std::size_t>(begin / parts.grain) * kRadix];
      for (std::int64_t i = begin; i < end; ++i) {
        const Keyed item = (*items)[static_cast<std::size_t>(i)];
        (*scratch)[position[(item.key >> shift) & (kRadix - 1)]++] = item;
      }
    });
    items->swap(*scratch);
  }
}

// Numbers the slots by Gaussian and lists the seen ones, in index order.
void NumberSlots(Frame* frame, AlignedVector<Keyed>* seen) {
  struct Sums {
    std::uint64_t slots = 0, seen = 0;
  };
  const std::int64_t n = frame->size;
  const Parts parts(n);
  std::vector<Sums> sums(static_cast<std::size_t>(parts.count) + 1);
  ParallelFor(n, parts.grain, [&](std::int64_t begin, std::int64_t end) {
    Sums sum;
    for (std::size_t j = static_cast<std::size_t>(begin); j < static_cast<std::size_t>(end); ++j) {
      const TileRect& rect = frame->rects[j];
      if (rect.x0 >= rect.x1) continue;
      sum.slots += rect.NumTiles(frame->SpansOf(j));
      ++sum.seen;
    }
    sums[static_cast<std::size_t>(begin / parts.grain) + 1] = sum;
  });
  for (std::size_t part = 1; part < sums.size(); ++part) {
    sums[part].slots += sums[part - 1].slots;
    sums[part].seen += sums[part - 1].seen;
  }
  const std::uint64_t slots = sums.back().slots;
  if (slots >= (std::uint64_t{1} << 32)) {
    throw InputError("the frame has " + std::to_string(slots) +
                     " (tile, Gaussian) pairs, more than 4294967295: render a smaller image");
  }
  frame->slot_begin.resize(static_cast<std::size_t>(n) + 1);
  frame->slot_begin[static_cast<std::size_t>(n)] = static_cast<std::uint32_t>(slots);
  seen->resize(sums.back().seen);
  ParallelFor(n, parts.grain, [&](std::int64_t begin, std::int64_t end) {
    Sums at = sums[static_cast<std::size_t>(begin / parts.grain)];
    for (std::size_t j = static_cast<std::size_t>(begin); j < static_cast<std::size_t>(end); ++j) {
      frame->slot_begin[j] = static_cast<std::uint32_t>(at.slots);
      const TileRect& rect = frame->rects[j];
      if (rect.x0 >= rect.x1) continue;
      at.slots += rect.NumTiles(frame->SpansOf(j));
      (*seen)[at.seen++] = {SortableBits(frame->order_key[j]), static_cast<std::uint32_t>(j)};
    }
  });
}

}  // namespace

// A counting sort three times over: slots by Gaussian, Gaussians by depth, pairs by tile. Each
// counts by part, sums up where every part's entries begin, and lets all parts write at once. Parts
// are cut by size alone and keep their order, so that the lists are those of one thread.
void BinTiles(const TileGrid& grid, Frame* frame) {
  // Kept by the calling thread, so that a frame allocates nothing after the first.
  thread_local AlignedVector<Keyed> seen, scratch;
  NumberSlots(frame, &seen);
  RadixSort(&seen, &scratch);
  const std::int64_t visible = static_cast<std::int64_t>(seen.size());
  frame->order.resize(seen.size());
  for (std::size_t i = 0; i < seen.size(); ++i) frame->order[i] = seen[i].index;

  // The Gaussians are walked in depth order, so each tile's list comes out sorted by depth.
  // Stable distribution: count by (part, tile), then every part fills its own places.
  const std::size_t tiles = static_cast<std::size_t>(grid.num_tiles());
  const Parts parts(visible);
  std::vector<std::uint32_t> counts(static_cast<std::size_t>(parts.count) * tiles, 0u);
  const auto for_each_tile = [&](std::int64_t begin, std::int64_t end, auto&& visit) {
    std::uint32_t* count = &counts[static_cast<std::size_t>(begin / parts.grain) * tiles];
    for (std::int64_t i = begin; i < end; ++i) {
      if (i + kFetchAhead < end) {
        const std::uint32_t ahead = frame->order[static_cast<std::size_t>(i + kFetchAhead)];
        __builtin_prefetch(&frame->rects[ahead]);
        __builtin_prefetch(&frame->slot_begin[ahead]);
      }
      const std::uint32_t gaussian = frame->order[static_cast<std::size_t>(i)];
      const TileRect rect = frame->rects[gaussian];
      std::uint32_t slot = frame->slot_begin[gaussian];
      rect.ForEachTile(frame->SpansOf(gaussian), [&](int x, int y) {
        visit(&count[static_cast<std::size_t>(y) * grid.tiles_x + x], gaussian, slot++);
      });
    }
  };
  ParallelFor(visible, parts.grain, [&](std::int64_t begin, std::int64_t end) {
    for_each_tile(begin, end, [](std::uint32_t* count, std::uint32_t, std::uint32_t) { ++*count; });
  });
  frame->tile_begin.resize(tiles + 1);
  std::uint32_t sum = 0;
  for (std::size_t tile = 0; tile < tiles; ++tile) {
    frame->tile_begin[tile] = sum;
    for (std::int64_t part = 0; part < parts.count && visible > 0; ++part) {
      std::uint32_t& count = counts[static_cast<std::size_t>(part) * tiles + tile];
      const std::uint32_t here = count;
      count = sum;
      sum += here;
    }
  }
  frame->tile_begin[tiles] = sum;
  frame->pairs.resize(sum);
  ParallelFor(visible, parts.grain, [&](std::int64_t begin, std::int64_t end) {
    for_each_tile(begin, end,
                  [&](std::uint32_t* position, std::uint32_t gaussian, std::uint32_t slot) {
                    frame->pairs[(*position)++] = {gaussian, slot};
                  });
  });
}

}  // namespace gsut
