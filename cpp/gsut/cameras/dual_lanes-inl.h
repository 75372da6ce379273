// Forward-mode derivatives of lanes: dual.h for one float in each lane.

#if defined(GSUT_CAMERAS_DUAL_LANES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_CAMERAS_DUAL_LANES_INL_H_
#undef GSUT_CAMERAS_DUAL_LANES_INL_H_
#else
#define GSUT_CAMERAS_DUAL_LANES_INL_H_
#endif

#include "gsut/base/lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// value + sum of grad[i] e_i with e_i e_j = 0. Comparisons look at the value only.
// A lens' Project, written once for any T, gives its derivatives by being called with this one.
struct DualLane {
  static constexpr int kDirections = 3;
  Lane value;
  Lane grad[kDirections];

  DualLane() = default;
  HWY_INLINE explicit DualLane(Lane constant) : value(constant) {
    for (Lane& g : grad) g = Lane(0.0);
  }
  HWY_INLINE explicit DualLane(double constant) : DualLane(Lane(constant)) {}
  HWY_INLINE explicit DualLane(float constant) : DualLane(Lane(constant)) {}
  HWY_INLINE explicit DualLane(int constant) : DualLane(Lane(constant)) {}
  // The variable number `direction`.
  HWY_INLINE DualLane(Lane v, int direction) : DualLane(v) { grad[direction] = Lane(1.0); }

  // f(value) with derivative f'(value).
  HWY_INLINE DualLane Chain(Lane f, Lane df) const {
    DualLane out;
    out.value = f;
    for (int i = 0; i < kDirections; ++i) out.grad[i] = df * grad[i];
    return out;
  }
};

// f(a, b) with partial derivatives fa, fb.
HWY_INLINE DualLane Chain(Lane f, const DualLane& a, Lane fa, const DualLane& b, Lane fb) {
  DualLane out;
  out.value = f;
  for (int i = 0; i < DualLane::kDirections; ++i) {
    out.grad[i] = MulAdd(fa, a.grad[i], fb * b.grad[i]);
  }
  return out;
}

HWY_INLINE DualLane operator-(const DualLane& a) { return a.Chain(-a.value, Lane(-1.0)); }
HWY_INLINE DualLane operator+(const DualLane& a, const DualLane& b) {
  DualLane out;
  out.value = a.value + b.value;
  for (int i = 0; i < DualLane::kDirections; ++i) out.grad[i] = a.grad[i] + b.grad[i];
  return out;
}
HWY_INLINE DualLane operator-(const DualLane& a, const DualLane& b) {
  DualLane out;
  out.value = a.value - b.value;
  for (int i = 0; i < DualLane::kDirections; ++i) out.grad[i] = a.grad[i] - b.grad[i];
  return out;
}
// Product rule d(ab) = b da + a db and quotient rule d(a / b) = (da - (a / b) db) / b.
HWY_INLINE DualLane operator*(const DualLane& a, const DualLane& b) {
  return Chain(a.value * b.value, a, b.value, b, a.value);
}
HWY_INLINE DualLane operator/(const DualLane& a, const DualLane& b) {
  const Lane inverse = Lane(1.0) / b.value;
  const Lane quotient = a.value * inverse;
  return Chain(quotient, a, inverse, b, -quotient * inverse);
}

// Branches follow the value: on their border the derivative is that of the side taken.
HWY_INLINE LaneMask operator<(const DualLane& a, const DualLane& b) { return a.value < b.value; }
HWY_INLINE LaneMask operator<=(const DualLane& a, const DualLane& b) { return a.value <= b.value; }
HWY_INLINE LaneMask operator>(const DualLane& a, const DualLane& b) { return a.value > b.value; }
HWY_INLINE LaneMask operator>=(const DualLane& a, const DualLane& b) { return a.value >= b.value; }

HWY_INLINE DualLane Select(LaneMask mask, const DualLane& yes, const DualLane& no) {
  DualLane out;
  out.value = Select(mask, yes.value, no.value);
  for (int i = 0; i < DualLane::kDirections; ++i) {
    out.grad[i] = Select(mask, yes.grad[i], no.grad[i]);
  }
  return out;
}

// d sqrt(a) = da / (2 sqrt(a)); d atan2(y, x) = (x dy - y dx) / (x^2 + y^2).
HWY_INLINE DualLane Sqrt(const DualLane& a) {
  const Lane root = Sqrt(a.value);
  return a.Chain(root, Lane(0.5) / root);
}
HWY_INLINE DualLane Abs(const DualLane& a) { return Select(a.value < Lane(0.0), -a, a); }
HWY_INLINE DualLane Min(const DualLane& a, const DualLane& b) { return Select(b < a, b, a); }
HWY_INLINE DualLane Max(const DualLane& a, const DualLane& b) { return Select(a < b, b, a); }
HWY_INLINE DualLane Atan2(const DualLane& y, const DualLane& x) {
  const Lane inverse = Lane(1.0) / (x.value * x.value + y.value * y.value);
  return Chain(Atan2(y.value, x.value), y, x.value * inverse, x, -y.value * inverse);
}
HWY_INLINE DualLane Atan(const DualLane& a) {
  return a.Chain(Atan(a.value), Lane(1.0) / MulAdd(a.value, a.value, Lane(1.0)));
}
HWY_INLINE DualLane Asin(const DualLane& a) {
  const Lane one(1.0);
  return a.Chain(Asin(a.value), one / Sqrt((one - a.value) * (one + a.value)));
}
HWY_INLINE DualLane Sin(const DualLane& a) { return a.Chain(Sin(a.value), Cos(a.value)); }
HWY_INLINE DualLane Cos(const DualLane& a) { return a.Chain(Cos(a.value), -Sin(a.value)); }
HWY_INLINE DualLane Tan(const DualLane& a) {
  const Lane tangent = Tan(a.value);
  return a.Chain(tangent, MulAdd(tangent, tangent, Lane(1.0)));
}
// A step function: its derivative is 0 wherever it has one.
HWY_INLINE DualLane Floor(const DualLane& a) { return DualLane(Floor(a.value)); }

// The entry of a table at a whole number; its derivatives are those of the entry.
template <class T>
requires std::is_same_v<T, DualLane> HWY_INLINE T At(const float* table, T index) {
  return DualLane(At<Lane>(table, index.value));
}

// Weighted sums of rows of a table: linear in the weights, so their derivatives are sums, too.
HWY_INLINE void SumRows(const float* table, const DualLane& first, int stride, int rows,
                        int columns, const DualLane* weight, DualLane* sums) {
  constexpr int kMaxRows = 4;
  Lane part[kMaxRows], part_sums[kRowLength];
  for (int j = 0; j < rows; ++j) part[j] = weight[j].value;
  SumRows(table, first.value, stride, rows, columns, part, part_sums);
  for (int k = 0; k < kRowLength; ++k) sums[k].value = part_sums[k];
  for (int i = 0; i < DualLane::kDirections; ++i) {
    for (int j = 0; j < rows; ++j) part[j] = weight[j].grad[i];
    SumRows(table, first.value, stride, rows, columns, part, part_sums);
    for (int k = 0; k < kRowLength; ++k) sums[k].grad[i] = part_sums[k];
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
