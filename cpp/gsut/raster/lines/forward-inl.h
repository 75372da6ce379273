// How lines without a common origin see a chunk of Gaussians in the forward pass, see
// blend_tile-inl.h.

#if defined(GSUT_RASTER_LINES_FORWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_FORWARD_INL_H_
#undef GSUT_RASTER_LINES_FORWARD_INL_H_
#else
#define GSUT_RASTER_LINES_FORWARD_INL_H_
#endif

#include "gsut/raster/blend_tile-inl.h"
#include "gsut/raster/lines/flat_hit-inl.h"
#include "gsut/raster/lines/pair-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

HWY_INLINE LinePixels LoadLines(const LineGrid& grid, std::size_t o) {
  const FloatTag d;
  return {hn::Load(d, &grid.a[o]), hn::Load(d, &grid.b[o]), hn::Load(d, &grid.tiles.s[o]),
          hn::Load(d, &grid.tiles.t[o]), hn::Load(d, &grid.slide[o])};
}

// What a LineKernel is built for. Flat primitives have one of their own, so that Gaussians keep
// their registers; one for either asks once a group, where compiling both does not pay.
enum class LineKind { kSolid, kFlat, kEither };

// Up to 64 Gaussians in the frame of one tile of lines.
template <LineKind kKind>
class LineKernel {
 public:
  // Gaussians blended together, to hide the latency of exponential and reciprocal. Their responses
  // take twice the registers of rays from one point, hence half as many.
  static constexpr int kJam = 2;

  HWY_INLINE LineKernel(const RasterTask& task, const LineGrid& grid, int tile, const Frame& frame)
      : task_(task),
        grid_(grid),
        frame_(frame),
        bundle_(grid.bundles[static_cast<std::size_t>(tile)].values),
        boxes_(&grid.block_box[static_cast<std::size_t>(tile) * 8 * kBlockStride]) {}

  HWY_INLINE void Fill(const TilePair* pairs, int count, int /*available*/,
                       std::uint64_t* blocks_of) {
    const auto ids = [&](int j) { return pairs[j].gaussian; };
    if (IsFlat()) {
      chunk_.Fill<true>(task_, frame_.records.data(), bundle_, count, ids);
      for (int j = 0; j < count; ++j) {
        blocks_of[j] = chunk_.TouchedFlat(j, boxes_, kBlockStride);
      }
      return;
    }
    chunk_.Fill<false>(task_, frame_.records.data(), bundle_, count, ids);
    for (int j = 0; j < count; ++j) {
      blocks_of[j] = chunk_.TouchedBlocks(j, boxes_, kBlockStride, bundle_[LineBundle::kSlide]);
    }
  }

  HWY_INLINE LinePixels LoadPixels(std::size_t o) const { return LoadLines(grid_, o); }

  // alpha = min(limit, alpha of raw = strength 2^(kappa u)), 0 where there is no hit, and the
  // distance from the line's own origin.
  HWY_INLINE void Respond(const LinePixels& lines, const int* index, FloatMask open, FloatVec limit,
                          FloatVec* alpha, FloatVec* distance, FloatMask* hit) const {
    if (IsFlat()) {
      RespondFlat(lines, index, open, limit, alpha, distance, hit);
      return;
    }
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      const LineHit response = HitOf(chunk_, index[i], lines);
      hit[i] = hn::And(open, IsHit(response, lines));
      distance[i] = hn::Sub(response.x, lines.slide);
      const FloatVec kappa = chunk_.Get(LineChunk::kKappa, index[i]);
      const FloatVec log2_strength = chunk_.Get(LineChunk::kLog2Strength, index[i]);
      alpha[i] = hn::MulAdd(kappa, response.u, log2_strength);
      alpha[i] = AlphaOf(alpha[i], limit, hit[i]);
    }
  }

  HWY_INLINE FloatVec Color(int channel, int j) const {
    return chunk_.Get(LineChunk::kRed + channel, j);
  }

 private:
  HWY_INLINE bool IsFlat() const {
    if constexpr (kKind == LineKind::kEither) return gsut::IsFlat(task_.gaussians.primitive);
    return kKind == LineKind::kFlat;
  }
  // exponent: log2 of raw.
  HWY_INLINE FloatVec AlphaOf(FloatVec exponent, FloatVec limit, FloatMask hit) const {
    FloatVec alpha = FastExp2(exponent);
    if (HWY_UNLIKELY(task_.is_extinction)) alpha = ExtinctionAlpha(alpha);
    return hn::IfThenElseZero(hit, hn::Min(alpha, limit));
  }

  HWY_INLINE void RespondFlat(const LinePixels& lines, const int* index, FloatMask open,
                              FloatVec limit, FloatVec* alpha, FloatVec* distance,
                              FloatMask* hit) const {
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      const FlatHit response = FlatHitOf(chunk_, index[i], lines);
      hit[i] = hn::And(open, IsHit(response, lines));
      distance[i] = hn::Sub(response.along, lines.slide);
      const FloatVec log2_raw =
          hn::Add(Log2(Lane(response.rest)).v, chunk_.Get(LineChunk::kLog2Strength, index[i]));
      alpha[i] = AlphaOf(log2_raw, limit, hit[i]);
    }
  }

  const RasterTask& task_;
  const LineGrid& grid_;
  const Frame& frame_;
  const float* bundle_;
  const float* boxes_;
  LineChunk chunk_;
};

// A function, so that what it inlines stays out of the caller.
template <class Run>
HWY_NOINLINE void RunFlatKernel(const RasterTask& task, const LineGrid& grid, int tile,
                                const Frame& frame, const Run& run) {
  LineKernel<LineKind::kFlat> kernel(task, grid, tile, frame);
  run(kernel);
}

// Calls run(kernel) with the kernel of a tile.
template <class Run>
HWY_INLINE void WithLineKernel(const RasterTask& task, const LineGrid& grid, int tile,
                               const Frame& frame, const Run& run) {
  if (HWY_UNLIKELY(IsFlat(task.gaussians.primitive))) {
    RunFlatKernel(task, grid, tile, frame, run);
    return;
  }
  LineKernel<LineKind::kSolid> kernel(task, grid, tile, frame);
  run(kernel);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
