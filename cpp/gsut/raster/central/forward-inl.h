// How the rays of one point see a chunk of Gaussians in the forward pass, see blend_tile-inl.h.

#if defined(GSUT_RASTER_CENTRAL_FORWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CENTRAL_FORWARD_INL_H_
#undef GSUT_RASTER_CENTRAL_FORWARD_INL_H_
#else
#define GSUT_RASTER_CENTRAL_FORWARD_INL_H_
#endif

#include "gsut/raster/blend_tile-inl.h"
#include "gsut/raster/central/response-inl.h"
#include "gsut/raster/central/tile_axes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Pairs by which records are fetched ahead: some microseconds, as long as memory takes.
inline constexpr int kPrefetch = 32;
// The same for the directions of sharp records: known to be sharp once the record is here.
inline constexpr int kPrefetchDirection = 8;

// Up to 64 records in the frame of one tile.
class CentralChunk {
 public:
  // Gaussians blended together, to hide the latency of exponential and reciprocal.
  static constexpr int kJam = 4;
  struct Pixels {
    FloatVec s, t;
  };

  HWY_INLINE CentralChunk(const TileGrid& grid, int tile, const Frame& frame)
      : grid_(grid),
        frame_(frame),
        axes_(ToTileAxes(grid, tile)),
        center_(&grid.center[static_cast<std::size_t>(tile) * kDirectionSize]),
        boxes_(&grid.block_box[static_cast<std::size_t>(tile) * 4 * kBlockStride]) {
    // N = 1 and z = 0 everywhere: hits nothing.
    for (float& value : rows_[kMissing]) value = 0.0f;
    rows_[kMissing][record::kA] = 1.0f;
  }

  // Turns the records of `count` pairs and bounds the blocks that they touch; `available` pairs lie
  // at `pairs` and may be fetched.
  HWY_INLINE void Fill(const TilePair* pairs, int count, int available, std::uint64_t* blocks_of) {
    const float* records = frame_.records.data();
    for (int j = 0; j < count; ++j) {
      if (j + kPrefetch < available) {
        hwy::Prefetch(records + std::size_t{record::kSize} * pairs[j + kPrefetch].gaussian);
        FetchDirection(frame_, pairs[j + kPrefetchDirection].gaussian);
      }
      TurnRecord(axes_, center_, frame_, pairs[j].gaussian, rows_[j]);
      blocks_of[j] = TouchedBlocks(rows_[j], boxes_);
    }
  }

  HWY_INLINE Pixels LoadPixels(std::size_t o) const {
    const FloatTag d;
    return {hn::Load(d, &grid_.s[o]), hn::Load(d, &grid_.t[o])};
  }

  // alpha = min(limit, alpha of raw = strength 2^(kappa u)), 0 where there is no hit, and the
  // distance, depth z / (z^2 + k N), in units of the ray. Step by step for all kJam at once, so
  // that they overlap.
  HWY_INLINE void Respond(const Pixels& pixels, const int* index, FloatMask open, FloatVec limit,
                          FloatVec* alpha, FloatVec* distance, FloatMask* hit) const {
    FloatVec n[kJam], z[kJam], reciprocal[kJam];
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      const RayForms forms = FormsAlong(rows_[index[i]], pixels.s, pixels.t);
      n[i] = forms.n;
      z[i] = forms.z;
      hit[i] = hn::And(open, forms.IsHit());
      reciprocal[i] = forms.Denominator(Value(record::kK, index[i]));
    }
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) reciprocal[i] = FastReciprocal(reciprocal[i]);
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      alpha[i] = hn::MulAdd(Value(record::kKappa, index[i]), hn::Mul(n[i], reciprocal[i]),
                            Value(record::kLog2Strength, index[i]));
    }
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) alpha[i] = FastExp2(alpha[i]);
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      alpha[i] = hn::IfThenElseZero(hit[i], hn::Min(alpha[i], limit));
      distance[i] = hn::Mul(Value(record::kDepth, index[i]), hn::Mul(z[i], reciprocal[i]));
    }
  }

  HWY_INLINE FloatVec Color(int channel, int j) const { return Value(record::kColor + channel, j); }

 private:
  HWY_INLINE FloatVec Value(int k, int j) const { return hn::Set(FloatTag(), rows_[j][k]); }

  const TileGrid& grid_;
  const Frame& frame_;
  const TileAxes axes_;
  const float* center_;
  const float* boxes_;
  HWY_ALIGN float rows_[kMissing + 1][record::kSize];
};

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
