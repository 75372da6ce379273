// Walks the blend back over one pair at one block of lines, a Gaussian or a triangle.

#if defined(GSUT_RASTER_LINES_LINE_FIELDS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_LINE_FIELDS_INL_H_
#undef GSUT_RASTER_LINES_LINE_FIELDS_INL_H_
#else
#define GSUT_RASTER_LINES_LINE_FIELDS_INL_H_
#endif

#include "gsut/raster/blend_backward-inl.h"
#include "gsut/raster/lines/pair-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Fields of a block's pixels beside PixelField.
enum LineField {
  kLineA = kNumPixelFields,
  kLineB,
  kLineSlide,
  // Gradients to the line, with rays only:
  kLineToA,
  kLineToB,
  kLineToS,
  kLineToT,
  kLineToSlide,
  kNumLineFields
};

// Where a slot holds V and K's upper triangle, row by row; the rest as in `slot`. Of
// triangles, see flat_backward-inl.h.
namespace line_slot {
inline constexpr int kV = 0;
inline constexpr int kK = 3;
}  // namespace line_slot

HWY_INLINE LinePixels LinesOf(BlockFields fields) {
  return {fields.Get(kLineA), fields.Get(kLineB), fields.Get(kFieldS), fields.Get(kFieldT),
          fields.Get(kLineSlide)};
}

// Walks the blend on over one pair. exponent: log2 of strength x response; distance: 0 without a
// hit. Returns the gradients to ln raw and to the distance.
HWY_INLINE ResponseGradient PassBlend(BackwardFlags flags, const BlendLimits& limits,
                                      const LineChunk& chunk, int j, FloatMask is_hit,
                                      FloatVec exponent, FloatVec distance, BlockFields fields,
                                      FloatVec* sums, float* pair) {
  using C = LineChunk;
  const FloatTag d;
  const FloatVec raw = FastExp2(exponent);
  const FloatVec alpha = HWY_UNLIKELY(limits.is_extinction) ? ExtinctionAlpha(raw) : raw;
  const FloatVec color[3] = {chunk.Get(C::kRed, j), chunk.Get(C::kGreen, j),
                             chunk.Get(C::kBlue, j)};
  ResponseGradient out =
      StepOver(flags, limits, color, hn::IfThenElseZero(is_hit, hn::Min(alpha, limits.alpha_max)),
               distance, fields, sums, pair);
  if (HWY_UNLIKELY(limits.is_extinction)) {
    constexpr float kLn2 = 0.69314718055994530942f;
    out.h = hn::Mul(out.h, hn::IfThenElseZero(is_hit, hn::Mul(hn::Set(d, kLn2), raw)));
  }
  sums[slot::kH] = hn::Add(sums[slot::kH], out.h);
  return out;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
