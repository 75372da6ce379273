// Where the lines of a block of pixels meet a triangle, see flat-inl.h.

#if defined(GSUT_RASTER_LINES_FLAT_HIT_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_FLAT_HIT_INL_H_
#undef GSUT_RASTER_LINES_FLAT_HIT_INL_H_
#else
#define GSUT_RASTER_LINES_FLAT_HIT_INL_H_
#endif

#include "gsut/raster/lines/pair-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

struct FlatHit {
  FloatVec x, y;        // in the plane, over k
  FloatVec gauge;       // over k
  FloatVec rest;        // 1 - gauge k / r
  FloatVec by_x, by_y;  // its derivatives
  FloatVec w_x, w_y;    // of (x, y) along the line
  FloatVec reciprocal;  // 1 / (n.d)
  FloatVec along;       // where on the line
};

HWY_INLINE FlatHit FlatHitOf(const LineChunk& chunk, int j, const LinePixels& line) {
  using C = LineChunk;
  const FloatTag d;
  FlatHit hit;
  const FloatVec depth = chunk.Get(C::kMd, j);
  const FloatVec a = hn::NegMulAdd(depth, line.s, hn::Sub(chunk.Get(C::kM1, j), line.a));
  const FloatVec b = hn::NegMulAdd(depth, line.t, hn::Sub(chunk.Get(C::kM2, j), line.b));
  const auto form = [&](int on_d, int on_e1, int on_e2) HWY_ATTR {
    return hn::MulAdd(chunk.Get(on_e1, j), line.s,
                      hn::MulAdd(chunk.Get(on_e2, j), line.t, chunk.Get(on_d, j)));
  };
  const auto across = [&](int on_e1, int on_e2) HWY_ATTR {
    return hn::MulAdd(chunk.Get(on_e1, j), a, hn::Mul(chunk.Get(on_e2, j), b));
  };
  hit.w_x = form(C::kWx0, C::kXa, C::kXb);
  hit.w_y = form(C::kWy0, C::kYa, C::kYb);
  hit.reciprocal = FastReciprocal(form(C::kNormal, C::kNormal + 1, C::kNormal + 2));
  const FloatVec xi = hn::Mul(across(C::kNormal + 1, C::kNormal + 2), hit.reciprocal);
  hit.x = hn::MulSub(xi, hit.w_x, across(C::kXa, C::kXb));
  hit.y = hn::MulSub(xi, hit.w_y, across(C::kYa, C::kYb));
  // The gauge, as Profile::Gauge.
  const FloatVec side = hn::CopySign(hn::Set(d, static_cast<float>(triangle::kRoot3)), hit.x);
  const FloatVec upper = hn::MulAdd(side, hit.x, hit.y);
  const FloatVec lower = hn::Mul(hn::Set(d, -2.0f), hit.y);
  const FloatMask is_lower = hn::Lt(upper, lower);
  hit.gauge = hn::Max(upper, lower);
  hit.by_x = hn::IfThenZeroElse(is_lower, side);
  hit.by_y = hn::IfThenElse(is_lower, hn::Set(d, -2.0f), hn::Set(d, 1.0f));
  // Of a miss as of the outline: a logarithm must be a number.
  constexpr float kLeastRest = 1e-30f;
  hit.rest = hn::Max(hn::NegMulAdd(hit.gauge, chunk.Get(C::kEnd, j), hn::Set(d, 1.0f)),
                     hn::Set(d, kLeastRest));
  hit.along = hn::Add(depth, xi);
  return hit;
}

// Drawn: inside the cut-off, and in front of the line's own origin. A line along the plane has no
// number for its gauge, and counts as a miss.
HWY_INLINE FloatMask IsHit(const FlatHit& hit, const LinePixels& line) {
  return hn::And(hn::Lt(hit.gauge, hn::Set(FloatTag(), 1.0f)), hn::Gt(hit.along, line.slide));
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
