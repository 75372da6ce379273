// Channels of a tile forward: blended by the weights of its pairs, and maps lifted onto the pairs.

#if defined(GSUT_RASTER_CHANNELS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CHANNELS_INL_H_
#undef GSUT_RASTER_CHANNELS_INL_H_
#else
#define GSUT_RASTER_CHANNELS_INL_H_
#endif

#include <algorithm>
#include <cstdint>
#include <type_traits>

#include "gsut/raster/channel_slices-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Where the weights of a tile's forward pass go, in segments; Run(sink) deals with a whole one.
template <class Derived>
class WeightSink {
 public:
  static constexpr bool kKeepsWeights = true;
  HWY_INLINE WeightSink() {}
  HWY_INLINE void Add(int block, int j, FloatVec weight, bool contributes) {
    const int at = lists_.Append(block, filled_ + j, contributes);
    hn::Store(weight, FloatTag(), lists_.Weights(at));
  }
  HWY_INLINE void EndChunk(const TilePair* pairs, int count, const std::uint64_t* contributed) {
    for (int j = 0; j < count; ++j) {
      gaussians_[filled_ + j] = pairs[j].gaussian;
      blocks_of_[filled_ + j] = contributed[j];
    }
    filled_ += count;
    if (filled_ + kChunk > kSegment) EndSegment();
  }
  // After the last chunk.
  HWY_INLINE void EndSegment() {
    static_cast<Derived*>(this)->Run();
    lists_.Clear();
    filled_ = 0;
  }

 protected:
  WeightLists lists_;
  int filled_ = 0;
  std::uint32_t gaussians_[kSegment];
  std::uint64_t blocks_of_[kSegment];
};

// Blends the channels of a tile's pairs into frame->channels.
class ChannelBlender : public WeightSink<ChannelBlender> {
 public:
  HWY_INLINE ChannelBlender(const RasterTask& task, int tile, Frame* frame)
      : rows_(task.channels),
        out_(&frame->channels[static_cast<std::size_t>(tile) * kTilePixels * rows_.padded()]) {}
  HWY_INLINE void Run() {
    constexpr int kAhead = 4;  // pairs
    for (int j = 0; j < filled_; ++j) {
      if (j + kAhead < filled_ && blocks_of_[j + kAhead] != 0) rows_.Fetch(gaussians_[j + kAhead]);
      if (blocks_of_[j] != 0) rows_.Fill(j, gaussians_[j]);
    }
    ForEachSlice(rows_.padded(), [&](std::size_t first, auto width) HWY_ATTR {
      for (int block = 0; block < kBlocks; ++block) AddToBlock(first, width, block);
    });
    is_first_ = false;
  }

 private:
  // In the order of the pairs, as colours are blended.
  template <int kWidth>
  HWY_INLINE void AddToBlock(std::size_t first, std::integral_constant<int, kWidth> width,
                             int block) {
    const int begin = WeightLists::First(block), end = begin + lists_.count(block);
    if (begin == end && !is_first_) return;
    const FloatTag d;
    const float* rows = rows_.Slice(first);
    float* to = out_ + PlaceInTile(first, width, block);
    FloatVec sums[kWidth];
    GSUT_UNROLL for (int k = 0; k < kWidth; ++k) sums[k] =
        is_first_ ? hn::Zero(d) : hn::Load(d, to + k * kLanes);
    for (int at = begin; at < end; ++at) {
      const FloatVec weight = hn::Load(d, lists_.Weights(at));
      const float* row = rows + lists_.pair(at) * kWidth;
      GSUT_UNROLL for (int k = 0; k < kWidth; ++k) {
        sums[k] = hn::MulAdd(weight, hn::Set(d, row[k]), sums[k]);
      }
    }
    GSUT_UNROLL for (int k = 0; k < kWidth; ++k) hn::Store(sums[k], d, to + k * kLanes);
  }

  ChannelRows rows_;
  float* out_;
  bool is_first_ = true;  // what frame->channels holds is an older frame's
};

// Sums of weight x value over a tile's pixels, for each of its entries.
class MapLifter : public WeightSink<MapLifter> {
 public:
  // map: (H, W, count); out: a row of `count` an entry, overwritten.
  HWY_INLINE MapLifter(const TileGrid& grid, int tile, const float* map, int count, float* out)
      : map_(grid, tile, map, count), out_(out) {}
  HWY_INLINE void Run() {
    int entries = 0, num = 0, taken[kBlocks] = {};
    for (int j = 0; j < filled_; ++j) {
      if (blocks_of_[j] == 0) continue;
      blocks_of_[entries++] = blocks_of_[j];
      for (std::uint64_t todo = blocks_of_[j]; todo != 0; todo &= todo - 1) {
        const int block = __builtin_ctzll(todo);
        places_[num++] = static_cast<std::uint16_t>(WeightLists::First(block) + taken[block]++);
      }
    }
    map_.SumByWeights(blocks_of_, entries, places_, lists_, out_);
    out_ += map_.count() * static_cast<std::size_t>(entries);
  }

 private:
  TileMap map_;
  float* out_;
  std::uint16_t places_[kSegment * kBlocks];
};

// Blends a tile, colours included, and writes its channels to image (H, W, D).
template <class Kernel>
HWY_INLINE void ForwardWithChannels(const RasterTask& task, const TileGrid& grid, int tile,
                                    Kernel& kernel, Frame* frame, float* image) {
  ChannelBlender blender(task, tile, frame);
  BlendTile(true, task, grid, tile, kernel, frame, &blender);
  blender.EndSegment();
  WriteChannels(task.channels, grid, tile, *frame, image);
}

// Blends a kept tile once more, with the same bits, for the sums of weight x map (H, W, count) over
// its pixels: a row an entry.
template <class Kernel>
HWY_INLINE void LiftTile(const RasterTask& task, const TileGrid& grid, int tile, Kernel& kernel,
                         const float* map, int count, Frame* frame, float* out) {
  MapLifter lifter(grid, tile, map, count, out);
  BlendTile(false, task, grid, tile, kernel, frame, &lifter);
  lifter.EndSegment();
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
