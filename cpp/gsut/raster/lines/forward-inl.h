// The forward pass of one tile of lines: as forward-inl.h blends rays that start at one point.

#if defined(GSUT_RASTER_LINES_FORWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_FORWARD_INL_H_
#undef GSUT_RASTER_LINES_FORWARD_INL_H_
#else
#define GSUT_RASTER_LINES_FORWARD_INL_H_
#endif

#include "gsut/raster/blend-inl.h"
#include "gsut/raster/lines/pair-inl.h"
#include "gsut/raster/task.h"
#include "gsut/raster/tile_math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Gaussians blended together, to hide the latency of exponential and reciprocal.
inline constexpr int kLineJam = 2;

HWY_INLINE LinePixels LoadLines(const LineGrid& grid, std::size_t o) {
  const FloatTag d;
  return {hn::Load(d, &grid.a[o]), hn::Load(d, &grid.b[o]), hn::Load(d, &grid.tiles.s[o]),
          hn::Load(d, &grid.tiles.t[o]), hn::Load(d, &grid.slide[o])};
}

// keep: leaves the list of contributing pairs for the backward pass.
// NOLINTNEXTLINE(readability-function-size): one loop whose state is in registers.
HWY_INLINE void ForwardLines(bool with_depth, bool keep, bool stop_before, const RasterTask& task,
                             const LineGrid& grid, int tile, Frame* frame) {
  const FloatTag d;
  const TileGrid& tiles = grid.tiles;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  for (int i = 0; i < kTilePixels; i += kLanes) {
    hn::Store(hn::Load(d, &tiles.start[pixel0 + i]), d, &frame->transmittance[pixel0 + i]);
    for (AlignedVector<float>& channel : frame->color) {
      hn::Store(hn::Zero(d), d, &channel[pixel0 + i]);
    }
    if (with_depth) StoreDepth(DepthSums::Zero(), pixel0 + static_cast<std::size_t>(i), frame);
  }
  const std::uint32_t begin = frame->tile_begin[tile];
  const std::uint32_t end = frame->tile_begin[tile + 1];
  std::uint32_t entries = 0;
  std::uint64_t alive = frame->alive[tile];
  const float* bundle = grid.bundles[static_cast<std::size_t>(tile)].values;
  const float* boxes = &grid.block_box[static_cast<std::size_t>(tile) * 8 * kBlockStride];
  const TilePair* pairs = frame->pairs.data();
  LineChunk chunk;
  std::uint64_t blocks_of[LineChunk::kPairs];
  std::uint64_t gaussians_of[kBlocks];
  std::uint64_t contributed[LineChunk::kPairs + 1];
  const FloatVec alpha_limit = hn::Set(d, task.alpha_max);
  const FloatVec stop = hn::Set(d, task.transmittance_min);

  for (std::uint32_t first = begin; first < end && alive != 0; first += LineChunk::kPairs) {
    const int count =
        static_cast<int>(HWY_MIN(end - first, static_cast<std::uint32_t>(LineChunk::kPairs)));
    chunk.Fill(frame->records.data(), bundle, task.log2_alpha_min, task.max_cutoff, count,
               [&](int j) { return pairs[first + static_cast<std::uint32_t>(j)].gaussian; });
    for (int j = 0; j < LineChunk::kPairs; ++j) {
      blocks_of[j] = j < count ? alive & chunk.TouchedBlocks(j, boxes, kBlockStride,
                                                             bundle[LineBundle::kSlide])
                               : 0;
    }
    TransposeMasks(blocks_of, gaussians_of);
    if (keep) {
      for (int j = 0; j < count; ++j) contributed[j] = 0;
    }
    for (std::uint64_t rest = alive; rest != 0; rest &= rest - 1) {
      const int block = __builtin_ctzll(rest);
      std::uint64_t todo = gaussians_of[block];
      if (todo == 0) continue;
      const std::size_t o = pixel0 + static_cast<std::size_t>(block) * kLanes;
      const LinePixels line = LoadLines(grid, o);
      FloatVec transmittance = hn::Load(d, &frame->transmittance[o]);
      FloatVec red = hn::Load(d, &frame->color[0][o]);
      FloatVec green = hn::Load(d, &frame->color[1][o]);
      FloatVec blue = hn::Load(d, &frame->color[2][o]);
      DepthSums depth = with_depth ? LoadDepth(*frame, o) : DepthSums::Zero();
      // Stopped pixels are below the limit (or negative, see Frame::transmittance).
      FloatMask open = hn::Ge(transmittance, stop);
      do {
        int index[kLineJam];
        FloatVec alpha[kLineJam], weight[kLineJam], along[kLineJam];
        FloatMask hit[kLineJam];
        GSUT_UNROLL for (int i = 0; i < kLineJam; ++i) {
          index[i] = todo != 0 ? __builtin_ctzll(todo) : LineChunk::kMissing;
          todo &= todo - 1;
        }
        GSUT_UNROLL for (int i = 0; i < kLineJam; ++i) {
          const LineHit response = HitOf(chunk, index[i], line);
          hit[i] = hn::And(open, IsHit(response, line));
          along[i] = hn::Sub(response.x, line.slide);
          alpha[i] = FastExp2(hn::MulAdd(chunk.Get(LineChunk::kKappa, index[i]), response.u,
                                         chunk.Get(LineChunk::kLog2Opacity, index[i])));
          alpha[i] = hn::IfThenElseZero(hit[i], hn::Min(alpha[i], alpha_limit));
        }
        if (BlendGroup<kLineJam>(stop_before, alpha, stop, hit, weight, &transmittance, &open)) {
          todo = 0;
        }
        GSUT_UNROLL for (int i = 0; i < kLineJam; ++i) {
          if (keep) {
            contributed[index[i]] |= static_cast<std::uint64_t>(!hn::AllFalse(d, hit[i])) << block;
          }
          red = hn::MulAdd(weight[i], chunk.Get(LineChunk::kRed, index[i]), red);
          green = hn::MulAdd(weight[i], chunk.Get(LineChunk::kGreen, index[i]), green);
          blue = hn::MulAdd(weight[i], chunk.Get(LineChunk::kBlue, index[i]), blue);
          if (with_depth) {
            // A miss may be anywhere: its weight 0 must not meet infinity.
            depth.Add(weight[i], hn::IfThenElseZero(hit[i], along[i]));
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
        const TilePair& pair = pairs[first + static_cast<std::uint32_t>(j)];
        frame->entries[begin + entries] = {pair.gaussian, pair.slot, contributed[j]};
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
