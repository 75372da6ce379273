// Vector lanes that read like a scalar: operators and functions over one Highway float vector, so
// that formulae (lenses above all) are written once for double, dual numbers and SIMD.
// Include inside a per-target translation unit only (Highway's foreach_target.h).

#if defined(GSUT_BASE_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_BASE_LANES_INL_H_
#undef GSUT_BASE_LANES_INL_H_
#else
#define GSUT_BASE_LANES_INL_H_
#endif

#include <hwy/highway.h>

#include <hwy/contrib/math/math-inl.h>

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// Sets of four lanes without a fused multiply-add divide where others refine an estimate: the same
// bits from all of them.
#undef GSUT_DIVIDES
#if HWY_TARGET == HWY_SSE4 || HWY_TARGET == HWY_WASM || HWY_TARGET == HWY_EMU128 || \
    HWY_TARGET == HWY_SCALAR
#define GSUT_DIVIDES 1
#else
#define GSUT_DIVIDES 0
#endif

using FloatTag = hn::ScalableTag<float>;
using FloatVec = hn::Vec<FloatTag>;
using FloatMask = hn::Mask<FloatTag>;

inline constexpr int kLanes = static_cast<int>(hn::MaxLanes(FloatTag()));

struct LaneMask {
  FloatMask m;
};

// One float in each lane.
struct Lane {
  FloatVec v;
  Lane() = default;  // uninitialised
  HWY_INLINE explicit Lane(FloatVec vec) : v(vec) {}
  HWY_INLINE explicit Lane(double x) : v(hn::Set(FloatTag(), static_cast<float>(x))) {}
  HWY_INLINE explicit Lane(float x) : v(hn::Set(FloatTag(), x)) {}
  HWY_INLINE explicit Lane(int x) : v(hn::Set(FloatTag(), static_cast<float>(x))) {}
};

HWY_INLINE Lane operator+(Lane a, Lane b) { return Lane(hn::Add(a.v, b.v)); }
HWY_INLINE Lane operator-(Lane a, Lane b) { return Lane(hn::Sub(a.v, b.v)); }
HWY_INLINE Lane operator*(Lane a, Lane b) { return Lane(hn::Mul(a.v, b.v)); }
HWY_INLINE Lane operator/(Lane a, Lane b) { return Lane(hn::Div(a.v, b.v)); }
HWY_INLINE Lane operator-(Lane a) { return Lane(hn::Neg(a.v)); }
HWY_INLINE Lane& operator+=(Lane& a, Lane b) { return a = a + b; }
HWY_INLINE Lane& operator-=(Lane& a, Lane b) { return a = a - b; }
HWY_INLINE Lane& operator*=(Lane& a, Lane b) { return a = a * b; }

HWY_INLINE LaneMask operator<(Lane a, Lane b) { return {hn::Lt(a.v, b.v)}; }
HWY_INLINE LaneMask operator<=(Lane a, Lane b) { return {hn::Le(a.v, b.v)}; }
HWY_INLINE LaneMask operator>(Lane a, Lane b) { return {hn::Gt(a.v, b.v)}; }
HWY_INLINE LaneMask operator>=(Lane a, Lane b) { return {hn::Ge(a.v, b.v)}; }
HWY_INLINE LaneMask AndMask(LaneMask a, LaneMask b) { return {hn::And(a.m, b.m)}; }
HWY_INLINE LaneMask OrMask(LaneMask a, LaneMask b) { return {hn::Or(a.m, b.m)}; }
HWY_INLINE LaneMask NotMask(LaneMask a) { return {hn::Not(a.m)}; }
HWY_INLINE Lane Select(LaneMask mask, Lane yes, Lane no) {
  return Lane(hn::IfThenElse(mask.m, yes.v, no.v));
}

HWY_INLINE Lane MulAdd(Lane a, Lane b, Lane c) { return Lane(hn::MulAdd(a.v, b.v, c.v)); }
HWY_INLINE Lane Sqrt(Lane a) { return Lane(hn::Sqrt(a.v)); }
HWY_INLINE Lane Abs(Lane a) { return Lane(hn::Abs(a.v)); }
HWY_INLINE Lane Min(Lane a, Lane b) { return Lane(hn::Min(a.v, b.v)); }
HWY_INLINE Lane Max(Lane a, Lane b) { return Lane(hn::Max(a.v, b.v)); }
HWY_INLINE Lane Exp(Lane a) { return Lane(hn::Exp(FloatTag(), a.v)); }
HWY_INLINE Lane Log(Lane a) { return Lane(hn::Log(FloatTag(), a.v)); }
HWY_INLINE Lane Log2(Lane a) { return Lane(hn::Log2(FloatTag(), a.v)); }
HWY_INLINE Lane Sin(Lane a) { return Lane(hn::Sin(FloatTag(), a.v)); }
HWY_INLINE Lane Cos(Lane a) { return Lane(hn::Cos(FloatTag(), a.v)); }
HWY_INLINE Lane Tan(Lane a) { return Sin(a) / Cos(a); }
HWY_INLINE Lane Atan(Lane a) { return Lane(hn::Atan(FloatTag(), a.v)); }
HWY_INLINE Lane Asin(Lane a) { return Lane(hn::Asin(FloatTag(), a.v)); }
HWY_INLINE Lane Floor(Lane a) { return Lane(hn::Floor(a.v)); }
HWY_INLINE LaneMask IsFinite(Lane a) { return {hn::IsFinite(a.v)}; }

// table[index] in each lane; index holds whole numbers. T is Lane, named as scalars name theirs.
template <class T>
HWY_INLINE T At(const float* table, T index) {
  const FloatTag d;
  return T(hn::GatherIndex(d, table, hn::ConvertTo(hn::RebindToSigned<FloatTag>(), index.v)));
}

// Weighted sums of rows of a table, another place in each lane: see gsut/cameras/contract.h. Reads
// kRowLength entries of each row whatever `columns` is, and writes kRowLength sums; at most 4 rows.
// Rows are read whole, lane after lane, which takes a fraction of the time of gathering entries.
inline constexpr int kRowLength = 8;

HWY_INLINE void SumRows(const float* table, Lane first, int stride, int rows, int /*columns*/,
                        const Lane* weight, Lane* sums) {
  constexpr int kMaxRows = 4;
  const FloatTag d;
  const hn::CappedTag<float, kRowLength> part;
  constexpr int kPart = static_cast<int>(hn::MaxLanes(part));
  HWY_ALIGN std::int32_t places[kLanes];
  HWY_ALIGN float weights[kMaxRows][kLanes];
  HWY_ALIGN float lines[kRowLength * kLanes];
  hn::Store(hn::ConvertTo(hn::RebindToSigned<FloatTag>(), first.v), hn::RebindToSigned<FloatTag>(),
            places);
  for (int j = 0; j < rows; ++j) hn::Store(weight[j].v, d, weights[j]);
  for (int lane = 0; lane < kLanes; ++lane) {
    for (int k = 0; k < kRowLength; k += kPart) {
      const float* row = table + places[lane] + k;
      auto sum = hn::Mul(hn::Set(part, weights[0][lane]), hn::LoadU(part, row));
      for (int j = 1; j < rows; ++j) {
        row += stride;
        sum = hn::MulAdd(hn::Set(part, weights[j][lane]), hn::LoadU(part, row), sum);
      }
      hn::Store(sum, part, lines + kRowLength * lane + k);
    }
  }
  // Columns k and k + 4 alternate in what is loaded, the second half of the lanes in `b`.
  constexpr int kHalf = kRowLength / 2;
  FloatVec a[kHalf], b[kHalf];
  hn::LoadInterleaved4(d, lines, a[0], a[1], a[2], a[3]);
  hn::LoadInterleaved4(d, lines + kHalf * kLanes, b[0], b[1], b[2], b[3]);
  for (int k = 0; k < kHalf; ++k) {
    sums[k].v = hn::ConcatEven(d, b[k], a[k]);
    sums[k + kHalf].v = hn::ConcatOdd(d, b[k], a[k]);
  }
}

// Arctangent of y / x in (-pi, pi]; 0 at the origin. Error at most 3 ulp of the result.
HWY_INLINE Lane Atan2(Lane y, Lane x) {
  const Lane ax = Abs(x);
  const Lane ay = Abs(y);
  const Lane big = Max(ax, ay);
  const Lane ratio = Min(ax, ay) / Select(big > Lane(0.0), big, Lane(1.0));
  const Lane octant = Atan(ratio);
  const Lane quadrant = Select(ay > ax, Lane(1.57079632679489662) - octant, octant);
  const Lane half = Select(x < Lane(0.0), Lane(3.14159265358979324) - quadrant, quadrant);
  return Lane(hn::CopySign(half.v, y.v));
}

// Bit i set where lane i of the mask is true.
HWY_INLINE std::uint64_t MaskBits(FloatMask mask) {
  std::uint8_t bytes[8] = {};
  hn::StoreMaskBits(FloatTag(), mask, bytes);
  std::uint64_t bits;
  __builtin_memcpy(&bits, bytes, sizeof bits);
  return kLanes < 8 ? bits & ((std::uint64_t{1} << kLanes) - 1) : bits;
}

// Exponential base 2 for x in [-126, 126]: relative error at most 2e-7 (polynomial: 9.2e-8).
// Beyond that range the result is arbitrary.
HWY_INLINE FloatVec FastExp2(FloatVec x) {
  const FloatTag d;
  const hn::RebindToUnsigned<FloatTag> du;
  // Adding 1.5 x 2^23 rounds to the nearest integer and leaves it in the low bits.
  const FloatVec magic = hn::Set(d, 12582912.0f);
  const FloatVec shifted = hn::Add(x, magic);
  const FloatVec f = hn::Sub(x, hn::Sub(shifted, magic));
  // Minimax polynomial of 2^f on [-1/2, 1/2], constant term exactly 1.
  FloatVec p = hn::MulAdd(hn::Set(d, 1.3264727214e-3f), f, hn::Set(d, 9.6715128126e-3f));
  p = hn::MulAdd(p, f, hn::Set(d, 5.5507337448e-2f));
  p = hn::MulAdd(p, f, hn::Set(d, 2.4022242083e-1f));
  p = hn::MulAdd(p, f, hn::Set(d, 6.9314697760e-1f));
  p = hn::MulAdd(p, f, hn::Set(d, 1.0f));
  return hn::BitCast(d, hn::Add(hn::BitCast(du, p), hn::ShiftLeft<23>(hn::BitCast(du, shifted))));
}

// 1 / x to within 1 ulp or two: an estimate refined by Newton.
HWY_INLINE FloatVec FastReciprocal(FloatVec x) {
#if GSUT_DIVIDES
  return hn::Div(hn::Set(FloatTag(), 1.0f), x);
#else
  const FloatVec r = hn::ApproximateReciprocal(x);
  return hn::Mul(r, hn::NegMulAdd(x, r, hn::Set(FloatTag(), 2.0f)));
#endif
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
