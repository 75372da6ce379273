// The backward pass of one triangle at one block of lines.
//
// With (x, y) over k where a line meets the plane and g the gauge there (flat-inl.h), raw =
// strength (1 - g k / r) gives -k^2 q as gradient to (x, y),
//   q = h / (k r (1 - g k / r)) (dg/dx, dg/dy),  h = raw dL/draw.
// Along the line (x, y) goes by w and the distance by 1, so that where on its line the hit lies
// gets -k^2 L (n.d),
//   L = (q.w - dL/ddistance / k^2) / (n.d),
// and that is moved by the mean and by the line's origin through n. Sums over lines:
//   V = (-q_x, -q_y, L),  K = (q_x x, q_x y, q_y x, q_y y, L x, L y),
// all in the primitive's own axes, from which gradients of its parameters follow (gradients-inl.h).

#if defined(GSUT_RASTER_LINES_FLAT_BACKWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_FLAT_BACKWARD_INL_H_
#undef GSUT_RASTER_LINES_FLAT_BACKWARD_INL_H_
#else
#define GSUT_RASTER_LINES_FLAT_BACKWARD_INL_H_
#endif

#include "gsut/raster/lines/flat_hit-inl.h"
#include "gsut/raster/lines/line_fields-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Adds to V and K, and with rays to the gradients to the block's lines.
HWY_INLINE void BackwardFlat(BackwardFlags flags, const BlendLimits& limits, const LineChunk& chunk,
                             int j, BlockFields fields, FloatVec* sums, float* pair) {
  using C = LineChunk;
  const FloatTag d;
  const LinePixels line = LinesOf(fields);
  const FlatHit hit = FlatHitOf(chunk, j, line);
  const FloatMask is_hit = IsHit(hit, line);
  const auto of_hit = [&](FloatVec value) HWY_ATTR { return hn::IfThenElseZero(is_hit, value); };
  // A miss may be anywhere: its weight 0 must not meet what is no number.
  const FloatVec log2_rest = of_hit(Log2(Lane(hit.rest)).v);
  const FloatVec exponent = hn::Add(log2_rest, chunk.Get(C::kLog2Strength, j));
  const auto [to_raw, to_distance] =
      PassBlend(flags, limits, chunk, j, is_hit, exponent, of_hit(hn::Sub(hit.along, line.slide)),
                fields, sums, pair);
  const FloatVec inverse = of_hit(FastReciprocal(hit.rest));
  const FloatVec x = of_hit(hit.x), y = of_hit(hit.y);
  constexpr float kTwoLn2 = 1.38629436111989061883f;
  const float cutoff = -kTwoLn2 * chunk.values[C::kKappa][j];  // k^2
  const float slope = chunk.values[C::kEnd][j] / cutoff;
  const FloatVec pull = hn::Mul(hn::Mul(to_raw, hn::Set(d, slope)), inverse);
  const FloatVec q_x = hn::Mul(pull, hit.by_x), q_y = hn::Mul(pull, hit.by_y);
  FloatVec along = hn::MulAdd(q_x, of_hit(hit.w_x), hn::Mul(q_y, of_hit(hit.w_y)));
  if (flags.with_depth) along = hn::NegMulAdd(to_distance, hn::Set(d, 1.0f / cutoff), along);
  const FloatVec moved = hn::Mul(along, of_hit(hit.reciprocal));
  FloatVec* sum_v = sums + line_slot::kV;
  FloatVec* sum_k = sums + line_slot::kK;
  sum_v[0] = hn::Sub(sum_v[0], q_x);
  sum_v[1] = hn::Sub(sum_v[1], q_y);
  sum_v[2] = hn::Add(sum_v[2], moved);
  const FloatVec factors[3] = {q_x, q_y, moved};
  GSUT_UNROLL for (int i = 0; i < 3; ++i) {
    sum_k[2 * i] = hn::MulAdd(factors[i], x, sum_k[2 * i]);
    sum_k[2 * i + 1] = hn::MulAdd(factors[i], y, sum_k[2 * i + 1]);
  }
  if (!flags.with_rays) return;
  // To the line's origin in the frame: k^2 (L n - q_x X - q_y Y).
  const auto to_origin = [&](int of_x, int of_y, int of_normal) HWY_ATTR {
    const FloatVec through = hn::Mul(moved, chunk.Get(of_normal, j));
    const FloatVec rest = hn::NegMulAdd(q_x, chunk.Get(of_x, j), through);
    return hn::Mul(hn::Set(d, cutoff), hn::NegMulAdd(q_y, chunk.Get(of_y, j), rest));
  };
  const FloatVec to_a = to_origin(C::kXa, C::kYa, C::kNormal + 1);
  const FloatVec to_b = to_origin(C::kXb, C::kYb, C::kNormal + 2);
  const FloatVec at = of_hit(hit.along);
  fields.Set(kLineToA, hn::Add(fields.Get(kLineToA), to_a));
  fields.Set(kLineToB, hn::Add(fields.Get(kLineToB), to_b));
  fields.Set(kLineToS, hn::MulAdd(at, to_a, fields.Get(kLineToS)));
  fields.Set(kLineToT, hn::MulAdd(at, to_b, fields.Get(kLineToT)));
  if (flags.with_depth) {
    fields.Set(kLineToSlide, hn::Sub(fields.Get(kLineToSlide), to_distance));
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
