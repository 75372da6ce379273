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

#include "gsut/raster/blend_backward-inl.h"
#include "gsut/raster/central/jacobian_kernel.h"
#include "gsut/raster/central/response-inl.h"
#include "gsut/raster/central/tile_axes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// What a block of pixels carries along from Gaussian to Gaussian, see TileFields.
inline constexpr int kSlopeT = 0;                             // transmittance
inline constexpr int kSlopeByLine = 1;                        // its derivatives by a, b, s, t
inline constexpr int kSlopeOut = kSlopeByLine + kLineSlopes;  // as TileSlopes
inline constexpr int kNumSlopeFields = kSlopeOut + TileSlopes::kSize;

// A Gaussian's blend at a block of pixels, and its slopes.
struct AlphaSlopes {
  FloatVec transmittance;       // T in front of it
  FloatVec alpha;               // 0 where it is not drawn
  FloatVec slope[kLineSlopes];  // dalpha by a, b, s, t
};

// Phase 1: evaluates alpha and its slopes, and steps T on.
HWY_INLINE AlphaSlopes EvaluateSlopes(const BlendLimits& limits, const float* r, FloatVec s,
                                      FloatVec t, BlockFields fields) {
  constexpr float kTwoLn2 = 1.38629436111989061883f;
  const FloatTag d;
  const RayForms forms = FormsAlong(r, s, t);
  AlphaSlopes out;
  out.transmittance = fields.Get(kSlopeT);
  FloatMask hit = hn::And(hn::Ge(out.transmittance, limits.stop), forms.IsHit());
  const FloatVec sum = forms.Denominator(hn::Set(d, r[record::kK]));
  const FloatVec reciprocal = hn::IfThenElseZero(hit, FastReciprocal(sum));
  const FloatVec kappa = hn::Set(d, r[record::kKappa]);
  const FloatVec log2_strength = hn::Set(d, r[record::kLog2Strength]);
  const FloatVec alpha = FastExp2(hn::MulAdd(kappa, hn::Mul(forms.n, reciprocal), log2_strength));
  out.alpha = hn::IfThenElseZero(hit, hn::Min(alpha, limits.alpha_max));
  FloatVec left = hn::NegMulAdd(out.alpha, out.transmittance, out.transmittance);
  if (HWY_UNLIKELY(limits.stop_before)) {
    const FloatMask ends = hn::And(hit, hn::Le(left, limits.stop));
    hit = hn::AndNot(ends, hit);
    out.alpha = hn::IfThenElseZero(hit, out.alpha);
    left = hn::IfThenElse(ends, hn::Neg(out.transmittance), left);
  }
  fields.Set(kSlopeT, left);
  // dalpha/ds = factor (z (p p_s + q q_s) - N z_s); 0 where alpha is clamped.
  const FloatVec moving = hn::IfThenElseZero(hn::Lt(alpha, limits.alpha_max), out.alpha);
  const FloatVec factor = hn::Mul(hn::Mul(hn::Set(d, kTwoLn2), hn::Mul(kappa, moving)),
                                  hn::Mul(forms.z, hn::Mul(reciprocal, reciprocal)));
  const auto by_direction = [&](int j) HWY_ATTR {
    const FloatVec half = hn::MulAdd(forms.p, hn::Set(d, r[record::kA + j]),
                                     hn::Mul(forms.q, hn::Set(d, r[record::kB + j])));
    return hn::Mul(factor,
                   hn::NegMulAdd(forms.n, hn::Set(d, r[record::kC + j]), hn::Mul(forms.z, half)));
  };
  // 1 / x = (z^2 + k N) / (depth z)
  const FloatVec inverse_x =
      hn::IfThenElseZero(hit, hn::Div(sum, hn::Mul(hn::Set(d, r[record::kDepth]), forms.z)));
  out.slope[2] = by_direction(1);
  out.slope[3] = by_direction(2);
  out.slope[0] = hn::Mul(out.slope[2], inverse_x);
  out.slope[1] = hn::Mul(out.slope[3], inverse_x);
  return out;
}

// Phase 2: adds to the colours' slopes, d(alpha T) c, and steps T's on: d(T (1 - alpha)). shading:
// the slopes of the Gaussian's own colour, or null.
HWY_INLINE void AddSlopes(const AlphaSlopes& of, const float* r, const float* shading,
                          BlockFields fields) {
  const FloatTag d;
  const FloatVec kept = hn::Sub(hn::Set(d, 1.0f), of.alpha);
  GSUT_UNROLL for (int k = 0; k < kLineSlopes; ++k) {
    const FloatVec before = fields.Get(kSlopeByLine + k);
    const FloatVec moved = hn::Mul(of.slope[k], of.transmittance);
    const FloatVec of_weight = hn::MulAdd(of.alpha, before, moved);
    fields.Set(kSlopeByLine + k, hn::MulSub(kept, before, moved));
    GSUT_UNROLL for (int c = 0; c < 3; ++c) {
      const int f = kSlopeOut + TileSlopes::ByLine(c, k);
      fields.Set(f, hn::MulAdd(of_weight, hn::Set(d, r[record::kColor + c]), fields.Get(f)));
    }
  }
  if (shading == nullptr) return;
  const FloatVec weight = hn::Mul(of.alpha, of.transmittance);
  GSUT_UNROLL for (int j = 0; j < kShadingSlopes; ++j) {
    const int f = kSlopeOut + TileSlopes::kShading + j;
    fields.Set(f, hn::MulAdd(weight, hn::Set(d, shading[j]), fields.Get(f)));
  }
}

// See JacobianKernel.
HWY_INLINE void TileJacobian(bool with_shading, const RasterTask& task, const TileGrid& grid,
                             int tile, const Frame& frame, const float* shading,
                             std::uint64_t wanted, float* slopes) {
  const FloatTag d;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  const TileAxes to_tile = ToTileAxes(grid, tile);
  const BlendLimits limits(task);
  TileFields<kNumSlopeFields> fields;
  for (int block = 0; block < kBlocks; ++block) {
    const BlockFields at = fields.Block(block);
    const std::size_t o = pixel0 + static_cast<std::size_t>(block) * kLanes;
    at.Set(kSlopeT, hn::Load(d, &grid.start[o]));
    for (int f = kSlopeByLine; f < kNumSlopeFields; ++f) at.Set(f, hn::Zero(d));
  }
  const std::uint32_t count = frame.entry_count[tile];
  const TileEntry* entries = &frame.entries[frame.tile_begin[tile]];
  for (std::uint32_t e = 0; e < count; ++e) {
    HWY_ALIGN float r[record::kSize];
    to_tile.Turn(&frame.records[std::size_t{record::kSize} * entries[e].gaussian], r);
    const float* of_gaussian =
        with_shading ? shading + std::size_t{kShadingSlopes} * entries[e].gaussian : nullptr;
    for (std::uint64_t todo = entries[e].blocks & wanted; todo != 0; todo &= todo - 1) {
      const int block = __builtin_ctzll(todo);
      const BlockFields at = fields.Block(block);
      const std::size_t o = pixel0 + static_cast<std::size_t>(block) * kLanes;
      const FloatVec s = hn::Load(d, &grid.s[o]), t = hn::Load(d, &grid.t[o]);
      AddSlopes(EvaluateSlopes(limits, r, s, t, at), r, of_gaussian, at);
    }
  }
  for (int block = 0; block < kBlocks; ++block) {
    const BlockFields at = fields.Block(block);
    for (int k = 0; k < kLineSlopes; ++k) {
      const FloatVec left = at.Get(kSlopeByLine + k);
      for (int c = 0; c < 3; ++c) {
        const int f = kSlopeOut + TileSlopes::ByLine(c, k);
        at.Set(f, hn::MulAdd(left, hn::Set(d, task.background[c]), at.Get(f)));
      }
    }
  }
  fields.Export(kSlopeOut, slopes);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
