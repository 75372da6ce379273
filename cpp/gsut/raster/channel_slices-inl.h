// Multiplies channels by blend weights, slice by slice, forward and backward.
//
// A pair's weights w at a block of pixels are computed once, whatever the number of channels, and
// held for kSegment pairs. With f_d its Gaussian's values, C_d = sum of w f_d + T_end background_d.
// In the backward pass its channels add v = sum over d of f_d dL/dC_d to the pair's v_i at a pixel
// (blend_backward-inl.h), and dL/df_d is the sum over pixels of w dL/dC_d. All three are products
// of small matrices, made for kSlice channels at a time, so that what is read again and again stays
// in the first cache and sums stay in registers.

#if defined(GSUT_RASTER_CHANNEL_SLICES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CHANNEL_SLICES_INL_H_
#undef GSUT_RASTER_CHANNEL_SLICES_INL_H_
#else
#define GSUT_RASTER_CHANNEL_SLICES_INL_H_
#endif

#include <algorithm>
#include <cstdint>
#include <type_traits>

#include "gsut/base/aligned_vector.h"
#include "gsut/raster/blend_tile-inl.h"
#include "gsut/raster/lane_rows-inl.h"
#include "gsut/raster/pixels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Pairs of a tile whose weights are held at a time: whole chunks of the forward pass.
inline constexpr int kSegment = 4 * kChunk;
// Channels that pass over the weights together, a vector of sums each; the last have fewer. As many
// as leave registers for what they are multiplied with.
inline constexpr int kSlice = kLanes == 16 ? 16 : 8;
static_assert(kSlice % kChannelStep == 0 && kSlice % kLanes == 0);

// Calls run(first, width) for the slices of `padded` channels; width is a constant.
template <class Run>
HWY_INLINE void ForEachSlice(std::size_t padded, const Run& run) {
  std::size_t first = 0;
  for (; first + kSlice <= padded; first += kSlice) {
    run(first, std::integral_constant<int, kSlice>());
  }
  const int rest = static_cast<int>(padded - first) / kChannelStep;
  if (rest == 1) run(first, std::integral_constant<int, 4>());
  if constexpr (kSlice == 16) {
    if (rest == 2) run(first, std::integral_constant<int, 8>());
    if (rest == 3) run(first, std::integral_constant<int, 12>());
  }
}

// Where a slice of 256 pixels begins in an array of (padded, 256) floats, and a block in the slice:
// the block's vectors, one a channel.
HWY_INLINE std::size_t PlaceInTile(std::size_t first, int width, int block) {
  return first * kTilePixels + static_cast<std::size_t>(block * width * kLanes);
}

// Buffers of a thread that only grow: allocating them anew would cost more than a small tile.
struct ChannelBuffers {
  AlignedVector<float> weights, rows, gradients;

  static HWY_INLINE ChannelBuffers& OfThread() {
    static thread_local ChannelBuffers buffers;
    return buffers;
  }
  static HWY_INLINE float* Grow(AlignedVector<float>* buffer, std::size_t size) {
    if (buffer->size() < size) {
      buffer->clear();
      buffer->resize(size);
    }
    return buffer->data();
  }
};

// The blend weights of a segment's pairs: a list a block of pixels, nearest first.
class WeightLists {
 public:
  HWY_INLINE WeightLists()
      : weights_(ChannelBuffers::Grow(&ChannelBuffers::OfThread().weights,
                                      std::size_t{kBlocks} * kStride * kLanes)) {
    Clear();
  }
  HWY_INLINE void Clear() { std::fill_n(count_, kBlocks, 0); }
  // A new pair's place in a block's list. Without is_kept the next pair takes the same place.
  HWY_INLINE int Append(int block, int pair, bool is_kept) {
    const int at = block * kStride + count_[block];
    pair_[at] = static_cast<std::uint16_t>(pair);
    count_[block] += is_kept ? 1 : 0;
    return at;
  }
  HWY_INLINE float* Weights(int at) { return weights_ + std::size_t{kLanes} * at; }
  HWY_INLINE int count(int block) const { return count_[block]; }
  HWY_INLINE static int First(int block) { return block * kStride; }
  HWY_INLINE int pair(int at) const { return pair_[at]; }

 private:
  // One place more than pairs, for one that is not kept.
  static constexpr int kStride = kSegment + 1;
  float* weights_;
  int count_[kBlocks];
  std::uint16_t pair_[kBlocks * kStride];
};

// The values of a segment's Gaussians by slices, a row a pair, filled up with zeros.
class ChannelRows {
 public:
  HWY_INLINE explicit ChannelRows(const Channels<float>& channels)
      : channels_(channels),
        padded_(PaddedChannels(channels.count)),
        values_(ChannelBuffers::Grow(&ChannelBuffers::OfThread().rows, padded_ * kSegment)) {}
  HWY_INLINE void Fill(int pair, std::uint32_t gaussian) const {
    const auto used = static_cast<std::size_t>(channels_.count);
    const float* from = channels_.values + used * gaussian;
    ForEachSlice(padded_, [&](std::size_t first, auto width) HWY_ATTR {
      float* to = Slice(first) + pair * width;
      const std::size_t count = std::min<std::size_t>(width, used - first);
      std::copy_n(from + first, count, to);
      std::fill(to + count, to + width, 0.0f);
    });
  }
  // Fetches the start of a Gaussian's values; the processor goes on by itself.
  HWY_INLINE void Fetch(std::uint32_t gaussian) const {
    hwy::Prefetch(channels_.values + static_cast<std::size_t>(channels_.count) * gaussian);
  }
  // (kSegment, width of the slice)
  HWY_INLINE float* Slice(std::size_t first) const { return values_ + first * kSegment; }
  HWY_INLINE std::size_t padded() const { return padded_; }

 private:
  const Channels<float>& channels_;
  std::size_t padded_;
  float* values_;
};

// Calls visit(offset of a block's vectors in the tile, lane, pixel index) for a block's pixels that
// lie inside the image.
template <class Visit>
HWY_INLINE void ForEachPixel(const TileGrid& grid, int tile, int block, const Visit& visit) {
  constexpr int kColumns = kTileSize / kBlockWidth;  // blocks
  constexpr int kRows = kLanes / kBlockWidth;        // pixels
  const int x0 = (tile % grid.tiles_x) * kTileSize + block % kColumns * kBlockWidth;
  const int y0 = (tile / grid.tiles_x) * kTileSize + block / kColumns * kRows;
  for (int lane = 0; lane < kLanes; ++lane) {
    const int x = x0 + lane % kBlockWidth, y = y0 + lane / kBlockWidth;
    if (x < grid.width && y < grid.height) {
      visit(lane, static_cast<std::size_t>(y) * grid.width + static_cast<std::size_t>(x));
    }
  }
}

// Writes a tile's channels to image (H, W, D), the background blended in.
HWY_INLINE void WriteChannels(const Channels<float>& channels, const TileGrid& grid, int tile,
                              const Frame& frame, float* image) {
  const FloatTag d;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  const auto count = static_cast<std::size_t>(channels.count);
  const std::size_t padded = PaddedChannels(channels.count);
  const float* values = &frame.channels[pixel0 * padded];
  HWY_ALIGN float row[kLanes];
  for (int block = 0; block < kBlocks; ++block) {
    const FloatVec left = hn::Abs(
        hn::Load(d, &frame.transmittance[pixel0 + static_cast<std::size_t>(block) * kLanes]));
    ForEachSlice(padded, [&](std::size_t first, auto width) HWY_ATTR {
      const float* from = values + PlaceInTile(first, width, block);
      for (int c = 0; c < width; c += kLanes) {
        const std::size_t at = first + static_cast<std::size_t>(c);
        FloatVec v[kLanes];
        GSUT_UNROLL for (int i = 0; i < kLanes; ++i) {
          const std::size_t channel = at + static_cast<std::size_t>(i);
          v[i] = channel < count ? hn::MulAdd(left, hn::Set(d, channels.background[channel]),
                                              hn::Load(d, from + (c + i) * kLanes))
                                 : hn::Zero(d);
        }
        TransposeLanes(v);
        const std::size_t here = std::min<std::size_t>(kLanes, count - std::min(at, count));
        ForEachPixel(grid, tile, block, [&](int lane, std::size_t pixel) HWY_ATTR {
          float* to = image + count * pixel + at;
          if (here == kLanes) {
            hn::StoreU(v[lane], d, to);
          } else {
            hn::Store(v[lane], d, row);
            std::copy_n(row, here, to);
          }
        });
      }
    });
  }
}

// Values at a tile's pixels, such as the gradients to its channels: by slices and blocks.
class TileMap {
 public:
  // image: (H, W, count). Pixels outside of it and channels that fill up have zeros.
  HWY_INLINE TileMap(const TileGrid& grid, int tile, const float* image, int count)
      : count_(static_cast<std::size_t>(count)),
        padded_(PaddedChannels(count)),
        values_(
            ChannelBuffers::Grow(&ChannelBuffers::OfThread().gradients, padded_ * kTilePixels)) {
    const FloatTag d;
    HWY_ALIGN float rows[kLanes * kLanes];
    for (int block = 0; block < kBlocks; ++block) {
      ForEachSlice(padded_, [&](std::size_t first, auto width) HWY_ATTR {
        float* to = values_ + PlaceInTile(first, width, block);
        for (int c = 0; c < width; c += kLanes) {
          const std::size_t at = first + static_cast<std::size_t>(c);
          const std::size_t here = std::min<std::size_t>(kLanes, count_ - std::min(at, count_));
          std::fill_n(rows, kLanes * kLanes, 0.0f);
          ForEachPixel(grid, tile, block, [&](int lane, std::size_t pixel) HWY_ATTR {
            const float* from = image + count_ * pixel + at;
            if (here == kLanes) {
              hn::Store(hn::LoadU(d, from), d, rows + lane * kLanes);
            } else {
              std::copy_n(from, here, rows + lane * kLanes);
            }
          });
          FloatVec v[kLanes];
          GSUT_UNROLL for (int i = 0; i < kLanes; ++i) v[i] = hn::Load(d, rows + i * kLanes);
          TransposeLanes(v);
          GSUT_UNROLL for (int i = 0; i < kLanes; ++i) {
            if (c + i < width) hn::Store(v[i], d, to + (c + i) * kLanes);
          }
        }
      });
    }
  }
  // The vectors of a block in a slice, one a channel.
  HWY_INLINE const float* At(std::size_t first, int width, int block) const {
    return values_ + PlaceInTile(first, width, block);
  }
  HWY_INLINE std::size_t count() const { return count_; }
  HWY_INLINE std::size_t padded() const { return padded_; }

  // For each of `pairs` pairs, with blocks_of[j] and the places of its weights in order of pairs
  // and blocks: the sums over pixels of weight x value, a row of `count` to out. Sums stay in lanes
  // until the last block, so that one reduction a slice suffices.
  HWY_INLINE void SumByWeights(const std::uint64_t* blocks_of, int pairs,
                               const std::uint16_t* places, WeightLists& lists, float* out) const {
    const FloatTag d;
    ForEachSlice(padded_, [&](std::size_t first, auto width) HWY_ATTR {
      const std::uint16_t* place = places;
      const std::size_t here = std::min<std::size_t>(width, count_ - first);
      for (int j = 0; j < pairs; ++j) {
        FloatVec sums[kSlice];
        GSUT_UNROLL for (int k = 0; k < kSlice; ++k) sums[k] = hn::Zero(d);
        for (std::uint64_t todo = blocks_of[j]; todo != 0; todo &= todo - 1) {
          const FloatVec weight = hn::Load(d, lists.Weights(*place++));
          const float* values = At(first, width, __builtin_ctzll(todo));
          constexpr int kWidth = decltype(width)::value;
          GSUT_UNROLL for (int k = 0; k < kWidth; ++k) {
            sums[k] = hn::MulAdd(weight, hn::Load(d, values + k * kLanes), sums[k]);
          }
        }
        HWY_ALIGN float totals[kSlice];
        SumLanes<kSlice>(sums, totals);
        std::copy_n(totals, here, out + count_ * static_cast<std::size_t>(j) + first);
      }
    });
  }

 private:
  std::size_t count_, padded_;
  float* values_;
};

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
