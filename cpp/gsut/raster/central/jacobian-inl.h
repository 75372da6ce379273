// Derivatives of one tile's colours by the lines of its pixels: forward mode, along with the blend.
//
// With d = D + s E1 + t E2 and u = N / (z^2 + k N) (frame.h), du/ds = 2 z (z (p p_s + q q_s) -
// N z_s) / (z^2 + k N)^2. Moving a line by a E1 is turning it by as much about the point nearest to
// the Gaussian, seen from the camera: d/da = d/ds / x, x the distance of that point in units of d.

#if defined(GSUT_RASTER_CENTRAL_JACOBIAN_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CENTRAL_JACOBIAN_INL_H_
#undef GSUT_RASTER_CENTRAL_JACOBIAN_INL_H_
#else
#define GSUT_RASTER_CENTRAL_JACOBIAN_INL_H_
#endif

#include "gsut/raster/blend-inl.h"
#include "gsut/raster/central/jacobian_kernel.h"
#include "gsut/raster/central/tile_axes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// State of a tile's pixels, block by block: fields of kLanes floats.
inline constexpr int kSlopeT = 0;                             // transmittance
inline constexpr int kSlopeByLine = 1;                        // its derivatives by a, b, s, t
inline constexpr int kSlopeOut = kSlopeByLine + kLineSlopes;  // as TileSlopes
inline constexpr int kNumSlopeFields = kSlopeOut + TileSlopes::kSize;

// NOLINTNEXTLINE(readability-function-size): one loop whose state is in registers.
HWY_INLINE void TileJacobian(bool stop_before, bool with_shading, const RasterTask& task,
                             const TileGrid& grid, int tile, const Frame& frame,
                             const float* shading, std::uint64_t wanted, float* slopes) {
  const FloatTag d;
  const std::uint32_t count = frame.entry_count[tile];
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  const TileAxes to_tile = ToTileAxes(grid, tile);
  HWY_ALIGN float state[kBlocks * kNumSlopeFields * kLanes];
  const auto field = [&](int block, int f)
                         HWY_ATTR { return state + (block * kNumSlopeFields + f) * kLanes; };
  __builtin_memset(state, 0, sizeof(state));
  for (int b = 0; b < kBlocks; ++b) {
    const std::size_t o = pixel0 + static_cast<std::size_t>(b) * kLanes;
    hn::Store(hn::Load(d, &grid.start[o]), d, field(b, kSlopeT));
  }
  const FloatVec limit = hn::Set(d, task.alpha_max), stop = hn::Set(d, task.transmittance_min);
  const FloatVec zero = hn::Zero(d);
  constexpr float kTwoLn2 = 1.38629436111989061883f;
  const TileEntry* entries = &frame.entries[frame.tile_begin[tile]];
  for (std::uint32_t e = 0; e < count; ++e) {
    HWY_ALIGN float r[record::kSize];
    to_tile.Turn(&frame.records[std::size_t{record::kSize} * entries[e].gaussian], r);
    const auto form = [&](int at, FloatVec s, FloatVec t) HWY_ATTR {
      return hn::MulAdd(hn::Set(d, r[at + 1]), s,
                        hn::MulAdd(hn::Set(d, r[at + 2]), t, hn::Set(d, r[at])));
    };
    const float* of_gaussian =
        with_shading ? shading + std::size_t{kShadingSlopes} * entries[e].gaussian : nullptr;
    for (std::uint64_t todo = entries[e].blocks & wanted; todo != 0; todo &= todo - 1) {
      const int block = __builtin_ctzll(todo);
      float* at = field(block, 0);
      const auto get = [&](int f) HWY_ATTR { return hn::Load(d, at + f * kLanes); };
      const auto put = [&](int f, FloatVec v) HWY_ATTR { hn::Store(v, d, at + f * kLanes); };
      const std::size_t o = pixel0 + static_cast<std::size_t>(block) * kLanes;
      const FloatVec s = hn::Load(d, &grid.s[o]), t = hn::Load(d, &grid.t[o]);
      // The same operations in the same order as the forward pass: the same bits, the same hits.
      const FloatVec p = form(record::kA, s, t), q = form(record::kB, s, t);
      const FloatVec z = hn::Max(form(record::kC, s, t), zero);
      const FloatVec n = hn::MulAdd(p, p, hn::Mul(q, q));
      const FloatVec zz = hn::Mul(z, z);
      const FloatVec transmittance = get(kSlopeT);
      FloatMask hit = hn::And(hn::Ge(transmittance, stop), hn::Lt(n, zz));
      const FloatVec sum = hn::MulAdd(hn::Set(d, r[record::kK]), n, zz);
      const FloatVec reciprocal = hn::IfThenElseZero(hit, FastReciprocal(sum));
      const FloatVec kappa = hn::Set(d, r[record::kKappa]);
      const FloatVec raw =
          FastExp2(hn::MulAdd(kappa, hn::Mul(n, reciprocal), hn::Set(d, r[record::kLog2Opacity])));
      FloatVec alpha = hn::IfThenElseZero(hit, hn::Min(raw, limit));
      FloatVec left = hn::NegMulAdd(alpha, transmittance, transmittance);
      if (stop_before) {
        const FloatMask ends = hn::And(hit, hn::Le(left, stop));
        hit = hn::AndNot(ends, hit);
        alpha = hn::IfThenElseZero(hit, alpha);
        left = hn::IfThenElse(ends, hn::Neg(transmittance), left);
      }
      put(kSlopeT, left);
      const FloatVec weight = hn::Mul(alpha, transmittance);
      // dalpha/ds = factor (z (p p_s + q q_s) - N z_s); 0 where alpha is clamped.
      const FloatVec moving = hn::IfThenElseZero(hn::Lt(raw, limit), alpha);
      const FloatVec factor = hn::Mul(hn::Mul(hn::Set(d, kTwoLn2), hn::Mul(kappa, moving)),
                                      hn::Mul(z, hn::Mul(reciprocal, reciprocal)));
      const auto by_direction = [&](int j) HWY_ATTR {
        const FloatVec half =
            hn::MulAdd(p, hn::Set(d, r[record::kA + j]), hn::Mul(q, hn::Set(d, r[record::kB + j])));
        return hn::Mul(factor, hn::NegMulAdd(n, hn::Set(d, r[record::kC + j]), hn::Mul(z, half)));
      };
      // 1 / x = (z^2 + k N) / (depth z)
      const FloatVec inverse_x =
          hn::IfThenElseZero(hit, hn::Div(sum, hn::Mul(hn::Set(d, r[record::kDepth]), z)));
      FloatVec slope[kLineSlopes];
      slope[2] = by_direction(1);
      slope[3] = by_direction(2);
      slope[0] = hn::Mul(slope[2], inverse_x);
      slope[1] = hn::Mul(slope[3], inverse_x);
      const FloatVec kept = hn::Sub(hn::Set(d, 1.0f), alpha);
      GSUT_UNROLL for (int k = 0; k < kLineSlopes; ++k) {
        const FloatVec before = get(kSlopeByLine + k);
        const FloatVec moved = hn::Mul(slope[k], transmittance);
        const FloatVec of_weight = hn::MulAdd(alpha, before, moved);
        put(kSlopeByLine + k, hn::MulSub(kept, before, moved));
        GSUT_UNROLL for (int c = 0; c < 3; ++c) {
          const int f = kSlopeOut + TileSlopes::ByLine(c, k);
          put(f, hn::MulAdd(of_weight, hn::Set(d, r[record::kColor + c]), get(f)));
        }
      }
      if (with_shading) {
        GSUT_UNROLL for (int j = 0; j < kShadingSlopes; ++j) {
          const int f = kSlopeOut + TileSlopes::kShading + j;
          put(f, hn::MulAdd(weight, hn::Set(d, of_gaussian[j]), get(f)));
        }
      }
    }
  }
  for (int b = 0; b < kBlocks; ++b) {
    for (int k = 0; k < kLineSlopes; ++k) {
      const FloatVec left = hn::Load(d, field(b, kSlopeByLine + k));
      for (int c = 0; c < 3; ++c) {
        float* at = field(b, kSlopeOut + TileSlopes::ByLine(c, k));
        hn::Store(hn::MulAdd(left, hn::Set(d, task.background[c]), hn::Load(d, at)), d, at);
      }
    }
    for (int f = 0; f < TileSlopes::kSize; ++f) {
      hn::Store(hn::Load(d, field(b, kSlopeOut + f)), d, slopes + f * kTilePixels + b * kLanes);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
