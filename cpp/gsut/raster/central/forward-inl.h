// The forward pass of one tile: blends the tile's Gaussians, nearest first, into 256 pixels.

#if defined(GSUT_RASTER_CENTRAL_FORWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CENTRAL_FORWARD_INL_H_
#undef GSUT_RASTER_CENTRAL_FORWARD_INL_H_
#else
#define GSUT_RASTER_CENTRAL_FORWARD_INL_H_
#endif

#include "gsut/raster/blend-inl.h"
#include "gsut/raster/central/tile_axes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Gaussians turned into the tile's frame at a time: one bit each of a 64-bit word.
inline constexpr int kChunk = 64;
// Gaussians blended together, to hide the latency of exponential and reciprocal.
inline constexpr int kForwardJam = 4;
// How far ahead records are fetched, and the directions of sharp ones, which are known by their
// records.
inline constexpr int kPrefetch = 32;
inline constexpr int kPrefetchDirection = 8;

// A record that hits nothing (N = 1, z = 0), to fill up the last group.
HWY_INLINE void StoreMissingRecord(float* r) {
  for (int k = 0; k < record::kSize; ++k) r[k] = 0.0f;
  r[record::kA] = 1.0f;
}

// keep: leaves the list of contributing pairs for the backward pass.
// NOLINTNEXTLINE(readability-function-size): one loop whose state is in registers.
HWY_INLINE void ForwardTile(bool with_depth, bool stop_before, const TileGrid& grid, int tile,
                            float alpha_max, float transmittance_min, bool keep, Frame* frame) {
  const FloatTag d;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  for (int i = 0; i < kTilePixels; i += kLanes) {
    hn::Store(hn::Load(d, &grid.start[pixel0 + i]), d, &frame->transmittance[pixel0 + i]);
    for (AlignedVector<float>& channel : frame->color) {
      hn::Store(hn::Zero(d), d, &channel[pixel0 + i]);
    }
    if (with_depth) StoreDepth(DepthSums::Zero(), pixel0 + static_cast<std::size_t>(i), frame);
  }
  const std::uint32_t begin = frame->tile_begin[tile];
  const std::uint32_t end = frame->tile_begin[tile + 1];
  std::uint32_t entries = 0;
  std::uint64_t alive = frame->alive[tile];
  const TileAxes axes = ToTileAxes(grid, tile);
  const float* center = &grid.center[static_cast<std::size_t>(tile) * kDirectionSize];
  const float* boxes = &grid.block_box[static_cast<std::size_t>(tile) * 4 * kBlockStride];
  const TilePair* pairs = frame->pairs.data();
  const float* records = frame->records.data();
  HWY_ALIGN float rows[kChunk + 1][record::kSize];
  StoreMissingRecord(rows[kChunk]);
  std::uint64_t blocks_of[kChunk];
  std::uint64_t gaussians_of[kBlocks];
  std::uint64_t contributed[kChunk + 1];
  const FloatVec alpha_limit = hn::Set(d, alpha_max);
  const FloatVec stop = hn::Set(d, transmittance_min);

  for (std::uint32_t chunk = begin; chunk < end && alive != 0; chunk += kChunk) {
    const int count = static_cast<int>(HWY_MIN(end - chunk, static_cast<std::uint32_t>(kChunk)));
    for (int j = 0; j < count; ++j) {
      if (chunk + j + kPrefetch < end) {
        hwy::Prefetch(records + std::size_t{record::kSize} * pairs[chunk + j + kPrefetch].gaussian);
        FetchDirection(*frame, pairs[chunk + j + kPrefetchDirection].gaussian);
      }
      TurnRecord(axes, center, *frame, pairs[chunk + j].gaussian, rows[j]);
      blocks_of[j] = TouchedBlocks(rows[j], boxes) & alive;
    }
    for (int j = count; j < kChunk; ++j) blocks_of[j] = 0;
    TransposeMasks(blocks_of, gaussians_of);
    for (int j = 0; j < count; ++j) contributed[j] = 0;

    for (std::uint64_t rest = alive; rest != 0; rest &= rest - 1) {
      const int block = __builtin_ctzll(rest);
      std::uint64_t todo = gaussians_of[block];
      if (todo == 0) continue;
      const std::size_t o = pixel0 + static_cast<std::size_t>(block) * kLanes;
      const FloatVec s = hn::Load(d, &grid.s[o]);
      const FloatVec t = hn::Load(d, &grid.t[o]);
      FloatVec transmittance = hn::Load(d, &frame->transmittance[o]);
      FloatVec red = hn::Load(d, &frame->color[0][o]);
      FloatVec green = hn::Load(d, &frame->color[1][o]);
      FloatVec blue = hn::Load(d, &frame->color[2][o]);
      DepthSums depth = with_depth ? LoadDepth(*frame, o) : DepthSums::Zero();
      // Stopped pixels are below the limit (or negative, see Frame::transmittance).
      FloatMask open = hn::Ge(transmittance, stop);
      do {
        int index[kForwardJam];
        const float* r[kForwardJam];
        FloatVec n[kForwardJam], z[kForwardJam], zz[kForwardJam], alpha[kForwardJam];
        FloatVec reciprocal[kForwardJam], weight[kForwardJam];
        FloatMask hit[kForwardJam];
        GSUT_UNROLL for (int i = 0; i < kForwardJam; ++i) {
          index[i] = todo != 0 ? __builtin_ctzll(todo) : kChunk;
          todo &= todo - 1;
          r[i] = rows[index[i]];
        }
        GSUT_UNROLL for (int i = 0; i < kForwardJam; ++i) {
          const FloatVec p = hn::MulAdd(hn::Set(d, r[i][1]), s,
                                        hn::MulAdd(hn::Set(d, r[i][2]), t, hn::Set(d, r[i][0])));
          const FloatVec q = hn::MulAdd(hn::Set(d, r[i][4]), s,
                                        hn::MulAdd(hn::Set(d, r[i][5]), t, hn::Set(d, r[i][3])));
          z[i] = hn::MulAdd(hn::Set(d, r[i][7]), s,
                            hn::MulAdd(hn::Set(d, r[i][8]), t, hn::Set(d, r[i][6])));
          z[i] = hn::Max(z[i], hn::Zero(d));
          n[i] = hn::MulAdd(p, p, hn::Mul(q, q));
          zz[i] = hn::Mul(z[i], z[i]);
        }
        GSUT_UNROLL for (int i = 0; i < kForwardJam; ++i) {
          hit[i] = hn::And(open, hn::Lt(n[i], zz[i]));
          zz[i] = hn::MulAdd(hn::Set(d, r[i][record::kK]), n[i], zz[i]);
        }
        GSUT_UNROLL for (int i = 0; i < kForwardJam; ++i) reciprocal[i] = FastReciprocal(zz[i]);
        GSUT_UNROLL for (int i = 0; i < kForwardJam; ++i) {
          alpha[i] = hn::MulAdd(hn::Set(d, r[i][record::kKappa]), hn::Mul(n[i], reciprocal[i]),
                                hn::Set(d, r[i][record::kLog2Opacity]));
        }
        GSUT_UNROLL for (int i = 0; i < kForwardJam; ++i) alpha[i] = FastExp2(alpha[i]);
        GSUT_UNROLL for (int i = 0; i < kForwardJam; ++i) {
          alpha[i] = hn::IfThenElseZero(hit[i], hn::Min(alpha[i], alpha_limit));
        }
        if (BlendGroup<kForwardJam>(stop_before, alpha, stop, hit, weight, &transmittance, &open)) {
          todo = 0;
        }
        GSUT_UNROLL for (int i = 0; i < kForwardJam; ++i) {
          contributed[index[i]] |= static_cast<std::uint64_t>(!hn::AllFalse(d, hit[i])) << block;
          red = hn::MulAdd(weight[i], hn::Set(d, r[i][record::kColor]), red);
          green = hn::MulAdd(weight[i], hn::Set(d, r[i][record::kColor + 1]), green);
          blue = hn::MulAdd(weight[i], hn::Set(d, r[i][record::kColor + 2]), blue);
          if (with_depth) {
            // A miss may have an infinite reciprocal: its weight 0 must not meet it.
            const FloatVec along = hn::IfThenElseZero(
                hit[i], hn::Mul(hn::Set(d, r[i][record::kDepth]), hn::Mul(z[i], reciprocal[i])));
            depth.Add(weight[i], along);
          }
        }
      } while (todo != 0);
      hn::Store(transmittance, d, &frame->transmittance[o]);
      hn::Store(red, d, &frame->color[0][o]);
      hn::Store(green, d, &frame->color[1][o]);
      hn::Store(blue, d, &frame->color[2][o]);
      if (with_depth) StoreDepth(depth, o, frame);
      if (hn::AllFalse(d, open)) alive &= ~(std::uint64_t{1} << block);
    }
    if (keep) {
      for (int j = 0; j < count; ++j) {
        if (contributed[j] == 0) continue;
        frame->entries[begin + entries] = {pairs[chunk + j].gaussian, pairs[chunk + j].slot,
                                           contributed[j]};
        ++entries;
      }
    }
  }
  if (keep) frame->entry_count[tile] = entries;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
