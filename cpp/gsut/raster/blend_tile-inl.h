// The forward pass of one tile, for any kind of rays: blends its Gaussians, nearest first.
//
// A kernel (central/forward-inl.h, lines/forward-inl.h) knows how one Gaussian responds along the
// rays of a block; everything else happens here, on chunks of 64 Gaussians until no pixel of the
// tile is open any more:
//   1. Kernel::Fill brings the chunk's Gaussians into the tile's frame and bounds which blocks of
//      pixels each of them may hit. The bit matrix is transposed: every block then knows its own
//      Gaussians, in order.
//   2. BlendBlock takes a block's pixels into registers and blends those Gaussians, Kernel::kJam at
//      a time: weight = alpha T, colour += weight c, T -= weight.
//   3. KeepEntries lists the pairs that contributed, so that the backward pass visits no others.
// A sink (channels-inl.h) also gets the blend weights of every pair at every block.

#if defined(GSUT_RASTER_BLEND_TILE_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_BLEND_TILE_INL_H_
#undef GSUT_RASTER_BLEND_TILE_INL_H_
#else
#define GSUT_RASTER_BLEND_TILE_INL_H_
#endif

#include "gsut/raster/blend-inl.h"
#include "gsut/raster/task.h"
#include "gsut/raster/tile_math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Gaussians brought into the tile's frame at a time: one bit each of a 64-bit word.
inline constexpr int kChunk = 64;
// Index in a chunk of a Gaussian that hits nothing. It fills up the last group of kJam.
inline constexpr int kMissing = kChunk;

// The sink of a pass that wants no weights.
struct NoSink {
  static constexpr bool kKeepsWeights = false;
};

// Sets the light of the tile's pixels to nothing blended yet: 0 where a pixel has no ray.
HWY_INLINE void ClearLight(const TileGrid& grid, std::size_t pixel0, Frame* frame) {
  const FloatTag d;
  for (std::size_t o = pixel0; o < pixel0 + kTilePixels; o += kLanes) {
    hn::Store(hn::Load(d, &grid.start[o]), d, &frame->transmittance[o]);
  }
}

// Sets the tile's pixels to nothing blended yet.
HWY_INLINE void ClearTile(bool with_depth, const TileGrid& grid, std::size_t pixel0, Frame* frame) {
  const FloatTag d;
  ClearLight(grid, pixel0, frame);
  for (std::size_t o = pixel0; o < pixel0 + kTilePixels; o += kLanes) {
    for (AlignedVector<float>& channel : frame->color) hn::Store(hn::Zero(d), d, &channel[o]);
    if (with_depth) StoreDepth(DepthSums::Zero(), o, frame);
  }
}

// Blends the Gaussians of a chunk whose bits are set in `todo` into the block at pixel o, and sets
// bit `block` of contributed[j] for each Gaussian j that added to a pixel. Returns whether all of
// the block's pixels have stopped.
template <class Kernel, class Sink>
HWY_INLINE bool BlendBlock(bool with_depth, const RasterTask& task, const Kernel& kernel,
                           std::uint64_t todo, int block, std::size_t o, std::uint64_t* contributed,
                           Frame* frame, Sink* sink) {
  constexpr int kJam = Kernel::kJam;
  const FloatTag d;
  const FloatVec alpha_limit = hn::Set(d, task.alpha_max);
  const StopRule rule(task);
  const auto pixels = kernel.LoadPixels(o);
  FloatVec transmittance = hn::Load(d, &frame->transmittance[o]);
  FloatVec red = hn::Load(d, &frame->color[0][o]);
  FloatVec green = hn::Load(d, &frame->color[1][o]);
  FloatVec blue = hn::Load(d, &frame->color[2][o]);
  DepthSums depth = with_depth ? LoadDepth(*frame, o) : DepthSums::Zero();
  // Stopped pixels are below the limit (or negative, see Frame::transmittance).
  FloatMask open = hn::Ge(transmittance, rule.stop);
  do {
    int index[kJam];
    FloatVec alpha[kJam], distance[kJam], weight[kJam];
    FloatMask hit[kJam];
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      index[i] = todo != 0 ? __builtin_ctzll(todo) : kMissing;
      todo &= todo - 1;
    }
    kernel.Respond(pixels, index, open, alpha_limit, alpha, distance, hit);
    if (BlendGroup<kJam>(rule, alpha, hit, weight, &transmittance, &open)) todo = 0;
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      const bool contributes = !hn::AllFalse(d, hit[i]);
      contributed[index[i]] |= static_cast<std::uint64_t>(contributes) << block;
      if constexpr (Sink::kKeepsWeights) sink->Add(block, index[i], weight[i], contributes);
      red = hn::MulAdd(weight[i], kernel.Color(0, index[i]), red);
      green = hn::MulAdd(weight[i], kernel.Color(1, index[i]), green);
      blue = hn::MulAdd(weight[i], kernel.Color(2, index[i]), blue);
      // The distance of a miss may be infinite: its weight 0 must not meet it.
      if (with_depth) depth.Add(weight[i], hn::IfThenElseZero(hit[i], distance[i]));
    }
  } while (todo != 0);
  hn::Store(transmittance, d, &frame->transmittance[o]);
  hn::Store(red, d, &frame->color[0][o]);
  hn::Store(green, d, &frame->color[1][o]);
  hn::Store(blue, d, &frame->color[2][o]);
  if (with_depth) StoreDepth(depth, o, frame);
  return hn::AllFalse(d, open);
}

// Appends the pairs of a chunk that contributed to a pixel to `entries`; returns their end.
HWY_INLINE TileEntry* KeepEntries(const TilePair* pairs, int count,
                                  const std::uint64_t* contributed, TileEntry* entries) {
  for (int j = 0; j < count; ++j) {
    if (contributed[j] != 0) *entries++ = {pairs[j].gaussian, pairs[j].slot, contributed[j]};
  }
  return entries;
}

// Blends all Gaussians of a tile into its 256 pixels; with task.keep, leaves the list of
// contributing pairs for the backward pass.
template <class Kernel, class Sink = NoSink>
HWY_INLINE void BlendTile(bool with_depth, const RasterTask& task, const TileGrid& grid, int tile,
                          Kernel& kernel, Frame* frame, Sink* sink = nullptr) {
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  ClearTile(with_depth, grid, pixel0, frame);
  const std::uint32_t begin = frame->tile_begin[tile];
  const std::uint32_t end = frame->tile_begin[tile + 1];
  std::uint64_t alive = frame->alive[tile];
  std::uint64_t blocks_of[kChunk];
  std::uint64_t gaussians_of[kBlocks];
  std::uint64_t contributed[kChunk + 1];
  TileEntry* const first_entry = task.keep ? &frame->entries[begin] : nullptr;
  TileEntry* last_entry = first_entry;
  for (std::uint32_t chunk = begin; chunk < end && alive != 0; chunk += kChunk) {
    const TilePair* pairs = &frame->pairs[chunk];
    const int available = static_cast<int>(end - chunk);
    const int count = HWY_MIN(available, kChunk);
    kernel.Fill(pairs, count, available, blocks_of);
    for (int j = 0; j < count; ++j) blocks_of[j] &= alive;
    for (int j = count; j < kChunk; ++j) blocks_of[j] = 0;
    TransposeMasks(blocks_of, gaussians_of);
    for (int j = 0; j < count; ++j) contributed[j] = 0;
    for (std::uint64_t rest = alive; rest != 0; rest &= rest - 1) {
      const int block = __builtin_ctzll(rest);
      if (gaussians_of[block] == 0) continue;
      const std::size_t o = pixel0 + static_cast<std::size_t>(block) * kLanes;
      if (BlendBlock(with_depth, task, kernel, gaussians_of[block], block, o, contributed, frame,
                     sink)) {
        alive &= ~(std::uint64_t{1} << block);
      }
    }
    if (task.keep) last_entry = KeepEntries(pairs, count, contributed, last_entry);
    if constexpr (Sink::kKeepsWeights) sink->EndChunk(pairs, count, contributed);
  }
  if (task.keep) frame->entry_count[tile] = static_cast<std::uint32_t>(last_entry - first_entry);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
