// Depth order by a stable radix sort, then a stable distribution of (tile, Gaussian) pairs.
#include "gsut/raster/bin_tiles.h"

#include <algorithm>
#include <bit>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"

namespace gsut {
namespace {

// Work is cut into at most this many parts, by size only.
constexpr std::int64_t kMaxParts = 64;
constexpr std::int64_t kMinPart = 8192;
constexpr int kRadixBits = 11;
constexpr std::uint32_t kRadix = 1u << kRadixBits;
// In depth order the Gaussians' rectangles lie anywhere: they are fetched so many ahead.
constexpr std::int64_t kFetchAhead = 16;

struct Parts {
  explicit Parts(std::int64_t n)
      : count(std::clamp<std::int64_t>(n / kMinPart, 1, kMaxParts)),
        grain((n + count - 1) / count) {
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
void RadixSort(std::vector<Keyed>* items, std::vector<Keyed>* scratch) {
  const std::int64_t n = static_cast<std::int64_t>(items->size());
  scratch->resize(items->size());
  const Parts parts(n);
  std::vector<std::uint32_t> counts(static_cast<std::size_t>(parts.count) * kRadix);
  for (int shift = 0; shift < 32; shift += kRadixBits) {
    std::fill(counts.begin(), counts.end(), 0u);
    ParallelFor(n, parts.grain, [&](std::int64_t begin, std::int64_t end) {
      std::uint32_t* count = &counts[static_cast<std::size_t>(begin / parts.grain) * kRadix];
      for (std::int64_t i = begin; i < end; ++i) {
        ++count[((*items)[static_cast<std::size_t>(i)].key >> shift) & (kRadix - 1)];
      }
    });
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

}  // namespace

void BinTiles(const TileGrid& grid, Frame* frame) {
  const std::int64_t n = frame->size;
  // Slots by Gaussian; the seen ones in index order.
  frame->slot_begin.resize(static_cast<std::size_t>(n) + 1);
  thread_local std::vector<Keyed> seen, scratch;
  seen.clear();
  std::uint64_t slots = 0;
  for (std::int64_t i = 0; i < n; ++i) {
    const std::size_t j = static_cast<std::size_t>(i);
    frame->slot_begin[j] = static_cast<std::uint32_t>(slots);
    const TileRect& rect = frame->rects[j];
    if (rect.x0 >= rect.x1) continue;
    slots += rect.NumTiles(frame->SpansOf(j));
    seen.push_back({SortableBits(frame->order_key[j]), static_cast<std::uint32_t>(i)});
  }
  frame->slot_begin[static_cast<std::size_t>(n)] = static_cast<std::uint32_t>(slots);
  if (slots >= (std::uint64_t{1} << 32)) {
    throw InputError("the frame has " + std::to_string(slots) +
                     " (tile, Gaussian) pairs, more than 4294967295: render a smaller image");
  }
  RadixSort(&seen, &scratch);
  const std::int64_t visible = static_cast<std::int64_t>(seen.size());
  frame->order.resize(seen.size());
  for (std::size_t i = 0; i < seen.size(); ++i) frame->order[i] = seen[i].index;

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
