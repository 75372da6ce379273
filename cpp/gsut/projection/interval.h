// Interval arithmetic: the range of a number that is known over a box only.
//
// Bounds are rounded to nearest, not outward: what is concluded from them is widened by
// kIntervalRounding in the end, a billion times the rounding of the sums and products of a lens.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

namespace gsut {

inline constexpr double kIntervalRounding = 1e-6;  // relative

struct Interval {
  double low = 0.0, high = 0.0;

  Interval() = default;
  Interval(double both) : Interval(both, both) {}  // NOLINT: constants are intervals
  Interval(double l, double h) : low(l), high(h) {
    if (!(low <= high)) *this = Whole();  // also what is no number
  }
  static Interval Whole() {
    Interval whole;
    whole.low = -std::numeric_limits<double>::infinity();
    whole.high = std::numeric_limits<double>::infinity();
    return whole;
  }
  bool IsZero() const { return low == 0.0 && high == 0.0; }
  bool IsFinite() const { return std::isfinite(low) && std::isfinite(high); }
  double Magnitude() const { return std::max(std::abs(low), std::abs(high)); }
  double Middle() const { return 0.5 * (low + high); }
  double Radius() const { return 0.5 * (high - low); }

  friend Interval operator-(Interval a) { return {-a.high, -a.low}; }
  friend Interval operator+(Interval a, Interval b) { return {a.low + b.low, a.high + b.high}; }
  friend Interval operator-(Interval a, Interval b) { return {a.low - b.high, a.high - b.low}; }
  friend Interval operator*(Interval a, Interval b) {
    if (a.IsZero() || b.IsZero()) return 0.0;  // the other is unknown, but a number
    const double p = a.low * b.low, q = a.low * b.high, r = a.high * b.low, s = a.high * b.high;
    if (std::isnan(p) || std::isnan(q) || std::isnan(r) || std::isnan(s)) return Whole();
    return {std::min({p, q, r, s}), std::max({p, q, r, s})};
  }
};

inline Interval Hull(Interval a, Interval b) {
  return {std::min(a.low, b.low), std::max(a.high, b.high)};
}

// What both say; they are bounds of the same number.
inline Interval Intersection(Interval a, Interval b) {
  const double low = std::max(a.low, b.low), high = std::min(a.high, b.high);
  return low <= high ? Interval(low, high) : a;  // apart by rounding only
}

inline Interval Square(Interval a) {
  const double p = a.low * a.low, q = a.high * a.high;
  const bool holds_zero = a.low < 0.0 && a.high > 0.0;
  return {holds_zero ? 0.0 : std::min(p, q), std::max(p, q)};
}

inline Interval Inverse(Interval a) {
  if (a.low <= 0.0 && a.high >= 0.0) return Interval::Whole();
  return {1.0 / a.high, 1.0 / a.low};
}

// Of what is known not to be negative.
inline Interval Root(Interval a) {
  return {std::sqrt(std::max(a.low, 0.0)), std::sqrt(std::max(a.high, 0.0))};
}

}  // namespace gsut
