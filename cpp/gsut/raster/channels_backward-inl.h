// Takes the gradients to a tile's channels on to its pairs' values and to their blend.

#if defined(GSUT_RASTER_CHANNELS_BACKWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CHANNELS_BACKWARD_INL_H_
#undef GSUT_RASTER_CHANNELS_BACKWARD_INL_H_
#else
#define GSUT_RASTER_CHANNELS_BACKWARD_INL_H_
#endif

#include <algorithm>
#include <cstdint>

#include "gsut/raster/blend_backward-inl.h"
#include "gsut/raster/channel_slices-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// The gradients to a tile's channels on their way to its pairs.
class TileChannels {
 public:
  // dimage (H, W, D); to_values: those of the tile's pairs, an entry a row of D, overwritten.
  HWY_INLINE TileChannels(const RasterTask& task, const TileGrid& grid, int tile,
                          const float* dimage, const Frame& frame, float* to_values)
      : channels_(task.channels),
        entries_(frame.entries.data() + frame.tile_begin[tile]),
        count_(frame.entry_count[tile]),
        rows_(task.channels),
        map_(grid, tile, dimage, task.channels.count),
        to_values_(to_values) {}

  // What the tile's pixels pass on before its pairs: final_transmittance[256] grows by dL/dT_end,
  // contribution[256] becomes the sum of dL/dC_d C_d, without the background.
  HWY_INLINE void AddToPixels(std::size_t pixel0, const Frame& frame, float* final_transmittance,
                              float* contribution) const {
    const FloatTag d;
    const float* values = &frame.channels[pixel0 * rows_.padded()];
    for (int block = 0; block < kBlocks; ++block) {
      FloatVec sum = hn::Zero(d), to_end = hn::Load(d, final_transmittance + block * kLanes);
      ForEachSlice(rows_.padded(), [&](std::size_t first, auto width) GSUT_INLINED_LAMBDA {
        const float* to = map_.At(first, width, block);
        const float* value = values + PlaceInTile(first, width, block);
        const auto here = static_cast<int>(std::min<std::size_t>(width, map_.count() - first));
        FloatVec of_slice = hn::Zero(d), end_of_slice = hn::Zero(d);
        for (int k = 0; k < here; ++k) {
          const FloatVec slope = hn::Load(d, to + k * kLanes);
          of_slice = hn::MulAdd(slope, hn::Load(d, value + k * kLanes), of_slice);
          const float behind = channels_.background[first + static_cast<std::size_t>(k)];
          end_of_slice = hn::MulAdd(slope, hn::Set(d, behind), end_of_slice);
        }
        sum = hn::Add(sum, of_slice);
        to_end = hn::Add(to_end, end_of_slice);
      });
      hn::Store(sum, d, contribution + block * kLanes);
      hn::Store(to_end, d, final_transmittance + block * kLanes);
    }
  }

  // Before entry e: with the first of a segment, what all of its pairs contribute at their pixels.
  HWY_INLINE void Prepare(std::uint32_t e) {
    if (e % kSegment != 0) return;
    first_ = e;
    here_ = static_cast<int>(HWY_MIN(count_ - e, std::uint32_t{kSegment}));
    next_ = 0;
    lists_.Clear();
    int num = 0;
    constexpr int kAhead = 4;  // pairs
    for (int j = 0; j < here_; ++j) {
      const TileEntry& entry = entries_[e + static_cast<std::uint32_t>(j)];
      if (j + kAhead < here_) rows_.Fetch((&entry)[kAhead].gaussian);
      rows_.Fill(j, entry.gaussian);
      blocks_of_[j] = entry.blocks;
      for (std::uint64_t todo = entry.blocks; todo != 0; todo &= todo - 1) {
        places_[num++] = static_cast<std::uint16_t>(lists_.Append(__builtin_ctzll(todo), j, true));
      }
    }
    for (int block = 0; block < kBlocks; ++block) {
      int at = WeightLists::First(block);
      const int end = at + lists_.count(block);
      for (; at + kWide <= end; at += kWide) AddContributions<kWide>(block, at);
      for (; at + kNarrow <= end; at += kNarrow) AddContributions<kNarrow>(block, at);
      for (; at < end; ++at) AddContributions<1>(block, at);
    }
  }

  // kLanes floats of the entry that was prepared, at the next of its blocks: see StepOver.
  HWY_INLINE float* NextPair() { return lists_.Weights(places_[next_++]); }

  // After entry e, whose weights are in its pairs: with the last of a segment, the gradients to the
  // values of all.
  HWY_INLINE void Finish(std::uint32_t e) {
    if (e + 1 != first_ + static_cast<std::uint32_t>(here_)) return;
    map_.SumByWeights(blocks_of_, here_, places_, lists_,
                      to_values_ + map_.count() * std::size_t{first_});
  }

 private:
  // Pairs whose sums stay in registers: enough to hide the latency of a sum.
  static constexpr int kWide = 8;
  // The same for the few that are left.
  static constexpr int kNarrow = 4;

  // Computes v of kPairs pairs of a block's list at its pixels.
  template <int kPairs>
  HWY_INLINE void AddContributions(int block, int at) {
    const FloatTag d;
    FloatVec sums[kPairs];
    GSUT_UNROLL for (int j = 0; j < kPairs; ++j) sums[j] = hn::Zero(d);
    ForEachSlice(rows_.padded(), [&](std::size_t first, auto width) GSUT_INLINED_LAMBDA {
      const float* to = map_.At(first, width, block);
      const float* row[kPairs];
      GSUT_UNROLL for (int j = 0; j < kPairs; ++j) {
        row[j] = rows_.Slice(first) + lists_.pair(at + j) * width;
      }
      for (int k = 0; k < width; ++k) {
        const FloatVec slope = hn::Load(d, to + k * kLanes);
        GSUT_UNROLL for (int j = 0; j < kPairs; ++j) {
          sums[j] = hn::MulAdd(slope, hn::Set(d, row[j][k]), sums[j]);
        }
      }
    });
    GSUT_UNROLL for (int j = 0; j < kPairs; ++j) hn::Store(sums[j], d, lists_.Weights(at + j));
  }

  const Channels<float>& channels_;
  const TileEntry* entries_;
  std::uint32_t count_, first_ = 0;
  int here_ = 0, next_ = 0;
  ChannelRows rows_;
  TileMap map_;
  float* to_values_;
  WeightLists lists_;
  std::uint64_t blocks_of_[kSegment];
  std::uint16_t places_[kSegment * kBlocks];
};

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
