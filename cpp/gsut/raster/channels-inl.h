// Channels of a tile, any number of them: blended by the weights of its pairs, and their gradients.
//
// A pair's weights w (256 pixels) are computed once, whatever the number of channels. With f_d its
// Gaussian's values, C_d = sum of w f_d + T_end background_d. In the backward pass its channels add
// v = sum over d of f_d dL/dC_d to what the pair is worth at a pixel (blend_backward-inl.h), and
// dL/df_d is the sum over pixels of w dL/dC_d: both are products of small matrices, made for
// kChannelPairs pairs at a time around the pass that turns v into w.

#if defined(GSUT_RASTER_CHANNELS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CHANNELS_INL_H_
#undef GSUT_RASTER_CHANNELS_INL_H_
#else
#define GSUT_RASTER_CHANNELS_INL_H_
#endif

#include <algorithm>
#include <cstdint>

#include "gsut/base/aligned_vector.h"
#include "gsut/raster/blend_backward-inl.h"
#include "gsut/raster/blend_tile-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Pairs whose weights at all pixels are held at a time.
inline constexpr int kChannelPairs = 16;

// The values of a few pairs' Gaussians, a row a pair, filled up with zeros.
class ChannelRows {
 public:
  HWY_INLINE ChannelRows(const Channels<float>& channels, int pairs)
      : channels_(channels),
        width_(PaddedChannels(channels.count)),
        values_(static_cast<std::size_t>(pairs) * width_) {
    std::fill(values_.begin(), values_.end(), 0.0f);
  }
  HWY_INLINE void Fill(const TileEntry* entries, int count) {
    const auto used = static_cast<std::size_t>(channels_.count);
    for (int j = 0; j < count; ++j) {
      std::copy_n(channels_.values + used * entries[j].gaussian, used, Row(j));
    }
  }
  HWY_INLINE float* Row(int j) { return &values_[static_cast<std::size_t>(j) * width_]; }
  HWY_INLINE std::size_t width() const { return width_; }

 private:
  const Channels<float>& channels_;
  std::size_t width_;
  AlignedVector<float> values_;
};

// Adds weights[i] x values of pair index[i], i < count, to the block's channels: `out` points at
// the block in the first channel's 256 pixels. In the order of the pairs.
template <int kStep>
HWY_INLINE void AddChannels(const float* weights, const int* index, int count, std::size_t first,
                            ChannelRows& rows, float* out) {
  const FloatTag d;
  FloatVec sums[kStep];
  float* to = out + first * kTilePixels;
  GSUT_UNROLL for (int k = 0; k < kStep; ++k) sums[k] = hn::Load(d, to + k * kTilePixels);
  for (int i = 0; i < count; ++i) {
    const FloatVec weight = hn::Load(d, weights + i * kLanes);
    const float* row = rows.Row(index[i]) + first;
    GSUT_UNROLL for (int k = 0; k < kStep; ++k) {
      sums[k] = hn::MulAdd(weight, hn::Set(d, row[k]), sums[k]);
    }
  }
  GSUT_UNROLL for (int k = 0; k < kStep; ++k) hn::Store(sums[k], d, to + k * kTilePixels);
}

// The weights of a chunk's pairs at one block, nearest first, by the forward pass's kernel: the
// same bits as in the image. Returns how many pairs were written to index and weights.
template <class Kernel>
HWY_INLINE int BlockWeights(const RasterTask& task, const Kernel& kernel, std::uint64_t todo,
                            std::size_t o, float* transmittance, int* index, float* weights) {
  constexpr int kJam = Kernel::kJam;
  const FloatTag d;
  const BlendLimits limits(task);
  const auto pixels = kernel.LoadPixels(o);
  FloatVec left = hn::Load(d, transmittance);
  int count = 0;
  while (todo != 0) {
    int group[kJam];
    FloatVec alpha[kJam], distance[kJam];
    FloatMask hit[kJam];
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      group[i] = todo != 0 ? __builtin_ctzll(todo) : kMissing;
      todo &= todo - 1;
    }
    kernel.Respond(pixels, group, hn::Ge(left, limits.stop), limits.alpha_max, alpha, distance,
                   hit);
    for (int i = 0; i < kJam && group[i] != kMissing; ++i) {
      const BlendStep step = StepBlend(task.stop_before, limits.stop, alpha[i], left);
      left = step.left;
      hn::Store(step.weight, d, weights + count * kLanes);
      index[count++] = group[i];
    }
  }
  hn::Store(left, d, transmittance);
  return count;
}

// Blends the channels of the pairs that the tile's forward pass kept into frame->channels.
template <class Kernel>
HWY_INLINE void BlendChannels(const RasterTask& task, const TileGrid& grid, int tile,
                              Kernel& kernel, Frame* frame) {
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  ChannelRows rows(task.channels, kChunk);
  float* out = &frame->channels[pixel0 * rows.width()];
  std::fill_n(out, kTilePixels * rows.width(), 0.0f);
  HWY_ALIGN float transmittance[kTilePixels];
  HWY_ALIGN float weights[kChunk * kLanes];
  std::copy_n(&grid.start[pixel0], kTilePixels, transmittance);
  const TileEntry* entries = frame->entries.data() + frame->tile_begin[tile];
  const std::uint32_t num_entries = frame->entry_count[tile];
  // A chunk of pairs at a time, and of these a block at a time: its weights, 64 vectors, stay in
  // the first cache while all channels pass over them.
  TilePair pairs[kChunk];
  std::uint64_t blocks_of[kChunk], gaussians_of[kBlocks];
  int index[kChunk];
  for (std::uint32_t first = 0; first < num_entries; first += kChunk, entries += kChunk) {
    const int count = static_cast<int>(HWY_MIN(num_entries - first, std::uint32_t{kChunk}));
    for (int j = 0; j < count; ++j) pairs[j] = {entries[j].gaussian, entries[j].slot};
    kernel.Fill(pairs, count, count, blocks_of);
    for (int j = 0; j < kChunk; ++j) blocks_of[j] = j < count ? entries[j].blocks : 0;
    TransposeMasks(blocks_of, gaussians_of);
    rows.Fill(entries, count);
    for (int block = 0; block < kBlocks; ++block) {
      if (gaussians_of[block] == 0) continue;
      const int at = block * kLanes;
      const int num =
          BlockWeights(task, kernel, gaussians_of[block], pixel0 + static_cast<std::size_t>(at),
                       transmittance + at, index, weights);
      std::size_t channel = 0;
      for (; channel + 2 * kChannelStep <= rows.width(); channel += 2 * kChannelStep) {
        AddChannels<2 * kChannelStep>(weights, index, num, channel, rows, out + at);
      }
      if (channel < rows.width()) {
        AddChannels<kChannelStep>(weights, index, num, channel, rows, out + at);
      }
    }
  }
}

// Writes a tile's channels to image (H, W, D), the background blended in.
HWY_INLINE void WriteChannels(const Channels<float>& channels, const TileGrid& grid, int tile,
                              const Frame& frame, float* image) {
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  const auto width = static_cast<std::size_t>(channels.count);
  const float* values = &frame.channels[pixel0 * PaddedChannels(channels.count)];
  ForEachRun(grid, tile, [&](int offset, std::size_t pixel, int count) HWY_ATTR {
    for (int i = 0; i < count; ++i) {
      const std::size_t at = static_cast<std::size_t>(offset + i);
      const float left = std::abs(frame.transmittance[pixel0 + at]);
      float* out = image + width * (pixel + static_cast<std::size_t>(i));
      for (std::size_t k = 0; k < width; ++k) {
        out[k] = values[k * kTilePixels + at] + left * channels.background[k];
      }
    }
  });
}

// The gradients to a tile's channels on their way to its pairs.
class TileChannels {
 public:
  // dimage (H, W, D); to_values: those of the tile's pairs, an entry a row of D, overwritten.
  HWY_INLINE TileChannels(const RasterTask& task, const TileGrid& grid, int tile,
                          const float* dimage, const Frame& frame, float* to_values)
      : channels_(task.channels),
        entries_(frame.entries.data() + frame.tile_begin[tile]),
        count_(frame.entry_count[tile]),
        rows_(task.channels, kChannelPairs),
        gradients_(rows_.width() * kTilePixels),
        to_values_(to_values) {
    std::fill(gradients_.begin(), gradients_.end(), 0.0f);
    const auto width = static_cast<std::size_t>(channels_.count);
    ForEachRun(grid, tile, [&](int offset, std::size_t pixel, int count) HWY_ATTR {
      for (int i = 0; i < count; ++i) {
        const float* from = dimage + width * (pixel + static_cast<std::size_t>(i));
        for (std::size_t k = 0; k < width; ++k) {
          gradients_[k * kTilePixels + static_cast<std::size_t>(offset + i)] = from[k];
        }
      }
    });
  }

  // What the tile's pixels pass on before its pairs: final_transmittance[256] grows by dL/dT_end,
  // worth[256] becomes the sum of dL/dC_d C_d, without the background.
  HWY_INLINE void AddToPixels(std::size_t pixel0, const Frame& frame, float* final_transmittance,
                              float* worth) const {
    const FloatTag d;
    const float* values = &frame.channels[pixel0 * rows_.width()];
    for (int at = 0; at < kTilePixels; at += kLanes) {
      FloatVec sum = hn::Zero(d), to_end = hn::Load(d, final_transmittance + at);
      for (std::size_t k = 0; k < static_cast<std::size_t>(channels_.count); ++k) {
        const FloatVec to = hn::Load(d, Gradient(k, at));
        sum = hn::MulAdd(to, hn::Load(d, values + k * kTilePixels + at), sum);
        to_end = hn::MulAdd(to, hn::Set(d, channels_.background[k]), to_end);
      }
      hn::Store(sum, d, worth + at);
      hn::Store(to_end, d, final_transmittance + at);
    }
  }

  // Of entry e at a block: kLanes floats, see StepOver.
  HWY_INLINE float* Pair(std::uint32_t e, int block) {
    return pairs_ + (e % kChannelPairs) * kTilePixels + block * kLanes;
  }

  // Before entry e: with the first of kChannelPairs, what all of these are worth at their pixels.
  HWY_INLINE void Prepare(std::uint32_t e) {
    if (e % kChannelPairs != 0) return;
    const int count = static_cast<int>(HWY_MIN(count_ - e, std::uint32_t{kChannelPairs}));
    rows_.Fill(entries_ + e, count);
    const FloatTag d;
    constexpr int kJam = 4;  // pairs whose sums stay in registers
    for (int block = 0; block < kBlocks; ++block) {
      int index[kChannelPairs + kJam];
      int num = 0;
      for (int j = 0; j < count; ++j) {
        if ((entries_[e + static_cast<std::uint32_t>(j)].blocks >> block) & 1) index[num++] = j;
      }
      if (num == 0) continue;
      // The last of them fills up the last group: computed twice, stored the same.
      for (int j = num; j < num + kJam; ++j) index[j] = index[num - 1];
      for (int i = 0; i < num; i += kJam) {
        FloatVec sums[kJam];
        GSUT_UNROLL for (int j = 0; j < kJam; ++j) sums[j] = hn::Zero(d);
        for (std::size_t k = 0; k < rows_.width(); ++k) {
          const FloatVec to = hn::Load(d, Gradient(k, block * kLanes));
          GSUT_UNROLL for (int j = 0; j < kJam; ++j) {
            sums[j] = hn::MulAdd(to, hn::Set(d, rows_.Row(index[i + j])[k]), sums[j]);
          }
        }
        GSUT_UNROLL for (int j = 0; j < kJam; ++j) {
          hn::Store(sums[j], d, Pair(e + static_cast<std::uint32_t>(index[i + j]), block));
        }
      }
    }
  }

  // After entry e, whose weights are in its pairs: the gradient to its values.
  // Sums over pixels stay in lanes until the last block, so that one reduction a channel suffices.
  HWY_INLINE void Collect(std::uint32_t e) {
    const FloatTag d;
    float* out = to_values_ + static_cast<std::size_t>(e) * channels_.count;
    for (int first = 0; first < channels_.count; first += kChannelStep) {
      FloatVec sums[kChannelStep];
      GSUT_UNROLL for (int k = 0; k < kChannelStep; ++k) sums[k] = hn::Zero(d);
      for (std::uint64_t todo = entries_[e].blocks; todo != 0; todo &= todo - 1) {
        const int block = __builtin_ctzll(todo);
        const FloatVec weight = hn::Load(d, Pair(e, block));
        const float* to = Gradient(static_cast<std::size_t>(first), block * kLanes);
        GSUT_UNROLL for (int k = 0; k < kChannelStep; ++k) {
          sums[k] = hn::MulAdd(weight, hn::Load(d, to + k * kTilePixels), sums[k]);
        }
      }
      for (int k = 0; k < HWY_MIN(kChannelStep, channels_.count - first); ++k) {
        out[first + k] = hn::GetLane(hn::SumOfLanes(d, sums[k]));
      }
    }
  }

 private:
  HWY_INLINE const float* Gradient(std::size_t channel, int at) const {
    return &gradients_[channel * kTilePixels + static_cast<std::size_t>(at)];
  }

  const Channels<float>& channels_;
  const TileEntry* entries_;
  std::uint32_t count_;
  ChannelRows rows_;
  AlignedVector<float> gradients_;  // (D, rounded up, 256)
  float* to_values_;
  HWY_ALIGN float pairs_[kChannelPairs * kTilePixels];
};

// Runs a tile's backward pass, run(flags, pixels, channels), with gradients to its channels. One
// build for each way to stop: depth and rays come along whether or not they are wanted.
template <class Run>
HWY_INLINE void BackwardWithChannels(const RasterTask& task, const TileGrid& grid, int tile,
                                     const ImageGradients& gradients, const Frame& frame,
                                     float* to_values, const Run& run) {
  // Planes that no gradient arrives for are read all the same, as zeros: see the flags below.
  HWY_ALIGN float buffer[7 * kTilePixels];
  HWY_ALIGN float worth[kTilePixels];
  std::fill_n(buffer, 7 * kTilePixels, 0.0f);
  PixelGradients pixels = ReadPixelGradients(grid, tile, gradients, task.background, buffer);
  TileChannels channels(task, grid, tile, gradients.channels, frame, to_values);
  channels.AddToPixels(static_cast<std::size_t>(tile) * kTilePixels, frame,
                       buffer + 3 * kTilePixels, worth);
  pixels.channels = worth;
  WithFlag(task.stop_before, [&](auto stops) HWY_ATTR {
    run(BackwardFlags{true, stops, true, false, true}, pixels, &channels);
  });
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
