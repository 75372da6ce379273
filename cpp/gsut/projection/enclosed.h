// A scalar for the lens contract that is known over a box of directions only: bounds of its value
// and of its derivatives up to the third. A lens that is given these returns proven bounds.
//
// A number is part, or part times the root of `square`. The second form keeps what is odd in the
// distance from the axis apart from what is even: an angle over a distance, 0 / 0 on the axis, is
// then as smooth there as the lens is.
#pragma once

#include <type_traits>

#include "gsut/projection/taylor_box.h"

namespace gsut {

// What a comparison says over the whole box.
struct Verdict {
  bool may_hold = true, may_fail = true;
  bool Holds() const { return !may_fail; }
  bool Fails() const { return !may_hold; }
};
inline Verdict AndMask(Verdict a, Verdict b) {
  return {a.may_hold && b.may_hold, a.may_fail || b.may_fail};
}
inline Verdict OrMask(Verdict a, Verdict b) {
  return {a.may_hold || b.may_hold, a.may_fail && b.may_fail};
}

// Over a box that lies on both sides of a step of Floor (control points of a spline) each piece is
// looked at by itself: Floor takes the piece of `choice`, and `pieces` counts them.
struct FloorPieces {
  int choice = 0, pieces = 1;
  static FloorPieces& Current() {
    static thread_local FloorPieces current;
    return current;
  }
};

struct Enclosed {
  TaylorBox part, square;
  bool is_root = false;

  Enclosed() = default;
  explicit Enclosed(double constant) : part(Interval(constant)) {}
  explicit Enclosed(const TaylorBox& number) : part(number) {}

  static Enclosed RootTimes(const TaylorBox& factor, const TaylorBox& under_root) {
    Enclosed out(factor);
    out.square = under_root;
    out.is_root = true;
    return out;
  }
  // Without the root.
  TaylorBox Plain() const { return is_root ? part * Root(square) : part; }
  Interval Value() const { return is_root ? part.c[0] * Root(square.c[0]) : part.c[0]; }
};

inline bool SameRoot(const Enclosed& a, const Enclosed& b) {
  if (!a.is_root || !b.is_root) return false;
  for (std::size_t i = 0; i < a.square.c.size(); ++i) {
    if (a.square.c[i].low != b.square.c[i].low || a.square.c[i].high != b.square.c[i].high) {
      return false;
    }
  }
  return true;
}

inline Enclosed operator-(const Enclosed& a) {
  Enclosed out = a;
  out.part = -a.part;
  return out;
}
inline Enclosed operator+(const Enclosed& a, const Enclosed& b) {
  if (SameRoot(a, b)) return Enclosed::RootTimes(a.part + b.part, a.square);
  return Enclosed(a.Plain() + b.Plain());
}
inline Enclosed operator-(const Enclosed& a, const Enclosed& b) {
  if (SameRoot(a, b)) return Enclosed::RootTimes(a.part - b.part, a.square);
  return Enclosed(a.Plain() - b.Plain());
}
inline Enclosed operator*(const Enclosed& a, const Enclosed& b) {
  if (SameRoot(a, b)) return Enclosed((&a == &b ? a.part * a.part : a.part * b.part) * a.square);
  if (a.is_root && !b.is_root) return Enclosed::RootTimes(a.part * b.part, a.square);
  if (b.is_root && !a.is_root) return Enclosed::RootTimes(a.part * b.part, b.square);
  if (a.is_root) return Enclosed(a.Plain() * b.Plain());
  return Enclosed(&a == &b ? a.part * a.part : a.part * b.part);
}
inline Enclosed operator/(const Enclosed& a, const Enclosed& b) {
  if (SameRoot(a, b)) return Enclosed(a.part * Inverse(b.part));
  if (a.is_root && !b.is_root) return Enclosed::RootTimes(a.part * Inverse(b.part), a.square);
  Enclosed out(a.Plain() * Inverse(b.Plain()));
  // Over what may vanish but is not negative, a value that is not negative is bounded from below.
  const Interval above = a.Value(), below = b.Value();
  if (above.low >= 0.0 && below.low == 0.0 && below.high > 0.0) {
    out.part.c[0].low = above.low / below.high;
  }
  return out;
}

// Directions on which two numbers are equal are no box: there, either answer is that of a
// neighbour.
inline Verdict operator<(const Enclosed& a, const Enclosed& b) {
  const Interval x = a.Value(), y = b.Value();
  if (x.low == x.high && y.low == y.high) return {x.low < y.low, !(x.low < y.low)};
  return {x.low<y.high, x.high> y.low};
}
inline Verdict operator>(const Enclosed& a, const Enclosed& b) { return b < a; }
inline Verdict operator>=(const Enclosed& a, const Enclosed& b) {
  const Verdict less = a < b;
  return {less.may_fail, less.may_hold};
}
inline Verdict operator<=(const Enclosed& a, const Enclosed& b) { return b >= a; }

inline Enclosed Select(Verdict mask, const Enclosed& yes, const Enclosed& no) {
  if (mask.Holds()) return yes;
  if (mask.Fails()) return no;
  if (SameRoot(yes, no)) return Enclosed::RootTimes(Hull(yes.part, no.part), yes.square);
  return Enclosed(Hull(yes.Plain(), no.Plain()));
}
inline Enclosed Min(const Enclosed& a, const Enclosed& b) {
  const Verdict first = b < a;
  Enclosed out = Select(first, b, a);
  if (first.may_hold && first.may_fail && !out.is_root) {
    out.part.c[0].high = std::min(a.Value().high, b.Value().high);
  }
  return out;
}
inline Enclosed Max(const Enclosed& a, const Enclosed& b) { return Select(a < b, b, a); }
inline Enclosed Abs(const Enclosed& a) { return Select(a < Enclosed(0.0), -a, a); }

inline Enclosed Sqrt(const Enclosed& a) {
  // Directions lie on a cube of half side 1: below this a root is near a point where it bends.
  constexpr double kNearZero = 0.3;
  const TaylorBox number = a.Plain();
  if (number.c[0].low < kNearZero && !number.IsConstant()) {
    return Enclosed::RootTimes(TaylorBox(Interval(1.0)), number);
  }
  return Enclosed(number.c[0].IsZero() ? TaylorBox(Interval(0.0)) : Root(number));
}

inline Enclosed Atan2(const Enclosed& y, const Enclosed& x) {
  constexpr double kLargestSquare = 1.5;  // of the tangent, for AngleOverTangent
  if (y.is_root && !x.is_root && x.part.c[0].low > 0.0) {
    const TaylorBox inverse = Inverse(x.part), slope = y.part * inverse;
    const TaylorBox q = slope * slope * y.square;
    if (q.c[0].high < kLargestSquare) {
      return Enclosed::RootTimes(slope * AngleOverTangent(q), y.square);
    }
  }
  return Enclosed(Angle(y.Plain(), x.Plain()));
}

// Sine and cosine: exact of constants, and by their slope of at most 1 elsewhere.
inline std::array<Interval, 2> SineCosine(Interval a) {
  const double middle = a.Middle(), radius = a.Radius();
  const auto around = [radius](double value) {
    return Interval(std::max(value - radius, -1.0), std::min(value + radius, 1.0));
  };
  return {around(std::sin(middle)), around(std::cos(middle))};
}
inline Enclosed Sin(const Enclosed& a) {
  const TaylorBox number = a.Plain();
  const auto [s, c] = SineCosine(number.c[0]);
  return Enclosed(Compose(number, {s, c, -0.5 * s, (-1.0 / 6.0) * c}));
}
inline Enclosed Cos(const Enclosed& a) {
  const TaylorBox number = a.Plain();
  const auto [s, c] = SineCosine(number.c[0]);
  return Enclosed(Compose(number, {c, -s, -0.5 * c, (1.0 / 6.0) * s}));
}
inline Enclosed Tan(const Enclosed& a) { return Sin(a) / Cos(a); }

inline Enclosed Floor(const Enclosed& a) {
  constexpr double kMostPieces = 4.0;
  const Interval value = a.Value();
  const double low = std::floor(value.low);
  // Up to a whole number, not with it: see the comparisons.
  const double high = std::max(low, std::ceil(value.high) - 1.0);
  const double count = high - low + 1.0;
  if (!(count <= kMostPieces)) return Enclosed(TaylorBox(Interval(low, high)));
  FloorPieces& pieces = FloorPieces::Current();
  const int here = static_cast<int>(count);
  const int piece = pieces.choice / pieces.pieces % here;
  pieces.pieces *= here;
  return Enclosed(low + piece);
}

// The entries of a table at whole numbers of a range.
template <class T, class P>
requires std::is_same_v<T, Enclosed> T At(const P* table, const T& index) {
  const Interval range = index.Value();
  constexpr double kLongest = 4096.0;
  if (!(range.low >= 0.0 && range.high - range.low < kLongest)) return T(TaylorBox::Whole());
  Interval all = static_cast<double>(table[static_cast<int>(range.low)]);
  for (int i = static_cast<int>(range.low) + 1; i <= static_cast<int>(range.high); ++i) {
    all = Hull(all, static_cast<double>(table[i]));
  }
  return T(TaylorBox(all));
}

}  // namespace gsut
