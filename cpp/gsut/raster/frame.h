// What one camera sees of the Gaussians: the records, lists and buffers of the tiled renderer.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gsut/base/aligned_vector.h"
#include "gsut/raster/blend_rule.h"

namespace gsut {

// A Gaussian of a frame is one cache line of 16 floats. With d the direction of a ray (any length)
// in the camera frame,
//   p = a.d, q = b.d, z = c.d, N = p^2 + q^2, u = N / (z^2 + k N), and
//   D^2 = u / s with kappa = -log2(e) / (2 s), so raw = strength 2^(kappa u) and alpha = raw or,
// under extinction, 1 - 2^-raw (gaussians/response.h),
// where D is the smallest Mahalanobis distance along the ray. The forms are scaled so that
// alpha >= alpha_min (and response >= response_min) exactly where N < z^2 and z > 0: no exponential
// and no division for a miss. The distance along a unit ray to that point is depth z / (z^2 + k N).
// Derivation: in whitened coordinates with axis 3 towards the mean, at distance g from the camera,
//   D^2 = g^2 (x^2 + y^2) / (x^2 + y^2 + z^2); s = 1 / tau - 1 / g^2, tau the cut-off of D^2;
//   k = 1 / (s g^2); p, q are x, y times sqrt(s) g, rotated so that a and b are orthogonal.
namespace record {
inline constexpr int kA = 0;              // a: 3 floats
inline constexpr int kB = 3;              // b
inline constexpr int kC = 6;              // c, scaled to c.(mean direction) = 1
inline constexpr int kK = 9;              // k
inline constexpr int kKappa = 10;         // kappa
inline constexpr int kLog2Strength = 11;  // see SeenLanes
inline constexpr int kColor = 12;         // 3 floats
inline constexpr int kDepth = 15;  // distance of the mean; negative: sharp, see sharp_records.h
inline constexpr int kSize = 16;
}  // namespace record

// A (tile, Gaussian) pair. Its slot is where the backward pass leaves the pair's gradient: slots
// are numbered by Gaussian and then by tile, so sums over a Gaussian's slots have one order.
struct TilePair {
  std::uint32_t gaussian;
  std::uint32_t slot;
};

// A pair that contributed to at least one pixel, with the blocks where it did.
struct TileEntry {
  std::uint32_t gaussian;
  std::uint32_t slot;
  std::uint64_t blocks;
};

// Tiles [begin, end) of one row.
struct RowSpan {
  std::uint16_t begin, end;
};

// The tiles of one Gaussian, inside [x0, x1) x [y0, y1); none if x0 >= x1. Of at most 64, the ones
// whose bit of `tiles` is set (row by row, bit 0 first); of more, one span a row, which start at
// index `tiles` of the spans of the Gaussian's part (see Frame::row_spans).
struct TileRect {
  std::uint16_t x0 = 0, x1 = 0, y0 = 0, y1 = 0;
  std::uint64_t tiles = 0;

  static constexpr std::uint32_t kMaxMasked = 64;
  std::uint32_t Area() const {
    return static_cast<std::uint32_t>(x1 - x0) * static_cast<std::uint32_t>(y1 - y0);
  }
  // visit(x, y) for each tile, in order; spans: of the Gaussian's part.
  template <class Visit>
  void ForEachTile(const std::vector<RowSpan>& spans, Visit&& visit) const {
    if (Area() <= kMaxMasked) {
      const int width = x1 - x0;
      for (std::uint64_t rest = tiles; rest != 0; rest &= rest - 1) {
        const int bit = std::countr_zero(rest);
        visit(x0 + bit % width, y0 + bit / width);
      }
      return;
    }
    for (int y = y0; y < y1; ++y) {
      const RowSpan span = spans[tiles + static_cast<std::size_t>(y - y0)];
      for (int x = span.begin; x < span.end; ++x) visit(x, y);
    }
  }
  // Takes out the tiles (row by row, tiles_x a row) that are 0 in `alive`, where it lists them one
  // by one; spans keep theirs.
  void Prune(const std::uint64_t* alive, int tiles_x) {
    if (x0 >= x1 || Area() > kMaxMasked) return;
    const int width = x1 - x0;
    for (std::uint64_t rest = tiles; rest != 0; rest &= rest - 1) {
      const int bit = std::countr_zero(rest);
      if (alive[(y0 + bit / width) * tiles_x + x0 + bit % width] == 0) {
        tiles &= ~(std::uint64_t{1} << bit);
      }
    }
    if (tiles == 0) *this = {};
  }
  std::uint32_t NumTiles(const std::vector<RowSpan>& spans) const {
    if (Area() <= kMaxMasked) return static_cast<std::uint32_t>(std::popcount(tiles));
    std::uint32_t sum = 0;
    for (std::size_t row = 0; row < static_cast<std::size_t>(y1 - y0); ++row) {
      sum += static_cast<std::uint32_t>(spans[tiles + row].end - spans[tiles + row].begin);
    }
    return sum;
  }
};

// Gaussians whose records are made together by one call; their spans share one array.
inline constexpr std::int64_t kRecordsPart = 2048;

// Channels are blended by four: the rest of the last four is 0.
inline constexpr int kChannelStep = 4;
constexpr std::size_t PaddedChannels(int count) {
  return static_cast<std::size_t>((count + kChannelStep - 1) / kChannelStep * kChannelStep);
}

// Buffers are kept from frame to frame and only grow.
struct Frame {
  std::int64_t size = 0;                        // Gaussians
  AlignedVector<float> records;                 // (size, 16)
  AlignedVector<float> mean_direction;          // (size, 8), of sharp records
  AlignedVector<float> order_key;               // (size)
  AlignedVector<TileRect> rects;                // (size); empty: not seen
  std::vector<std::vector<RowSpan>> row_spans;  // one array a part of kRecordsPart Gaussians
  AlignedVector<std::uint64_t> alive;           // (tiles) the grid's; 0: the tile is left out
  AlignedVector<std::uint32_t> slot_begin;      // (size + 1)
  AlignedVector<std::uint32_t> order;           // seen Gaussians, nearest first
  AlignedVector<TilePair> pairs;                // by tile, nearest first
  AlignedVector<std::uint32_t> tile_begin;      // (tiles + 1)

  // Results of the forward pass by tile, swizzled as the tile grid (256 floats a tile).
  AlignedVector<float> transmittance;  // negative: stopped before the Gaussian that would cross
  AlignedVector<float> color[3];
  AlignedVector<float> depth;
  AlignedVector<float> first_depth;   // of the first Gaussian that was blended; 0: none
  AlignedVector<float> depth_moment;  // sum of weight x (distance - first_depth)^2
  AlignedVector<float> channels;      // without background, see TileMap in channel_slices-inl.h
  AlignedVector<TileEntry> entries;   // at the offsets of `pairs`
  AlignedVector<std::uint32_t> entry_count;  // (tiles)

  // Results of the backward pass.
  AlignedVector<float> slot_gradients;       // (slots, 16)
  AlignedVector<std::uint8_t> slot_touched;  // (slots)

  const std::vector<RowSpan>& SpansOf(std::size_t gaussian) const {
    return row_spans[gaussian / static_cast<std::size_t>(kRecordsPart)];
  }
  // Of the pixel at `i` of `depth`, about its mean; start: its first transmittance.
  double Distortion(std::size_t i, double start) const {
    const double alpha = start - std::abs(static_cast<double>(transmittance[i]));
    if (!(alpha >= kDistortionAlpha)) return 0.0;
    const double shift =
        static_cast<double>(depth[i]) - alpha * static_cast<double>(first_depth[i]);
    return std::max(static_cast<double>(depth_moment[i]) - shift * shift / alpha, 0.0);
  }
  std::size_t num_pairs() const { return pairs.size(); }
};

// Layout of a slot's gradient: sums over the pair's pixels of dL/da, dL/db, dL/dc (up to the factor
// kFormScale x kappa, see gradients-inl.h), of h u and h with h = alpha dL/dalpha, of dL/dcolor, of
// dL/ddepth and of weight x error.
namespace slot {
inline constexpr int kHu = 9;
inline constexpr int kH = 10;
inline constexpr int kColor = 11;
inline constexpr int kDepth = 14;
inline constexpr int kError = 15;  // of all kinds of rays
}  // namespace slot

}  // namespace gsut
