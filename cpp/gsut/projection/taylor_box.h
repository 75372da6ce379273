// Taylor coefficients up to the third order in two variables, each bounded over a box.
//
// At every point of the box the coefficients of the function there lie within. Sums, products and
// compositions are those of Taylor polynomials cut at the third order, so they keep that promise.
#pragma once

#include <array>

#include "gsut/projection/interval.h"

namespace gsut {

struct TaylorBox {
  // 1; x, y; xx, xy, yy; xxx, xxy, xyy, yyy.
  static constexpr int kSize = 10;
  static constexpr int kDegree[kSize] = {0, 1, 1, 2, 2, 2, 3, 3, 3, 3};
  static constexpr int kInX[kSize] = {0, 1, 0, 2, 1, 0, 3, 2, 1, 0};
  std::array<Interval, kSize> c;

  TaylorBox() = default;
  explicit TaylorBox(Interval constant) { c[0] = constant; }

  static TaylorBox Whole() {
    TaylorBox out;
    out.c.fill(Interval::Whole());
    return out;
  }
  bool IsConstant() const {
    for (int i = 1; i < kSize; ++i) {
      if (!c[static_cast<std::size_t>(i)].IsZero()) return false;
    }
    return true;
  }
};

// Index of the product of two monomials; -1 beyond the third order.
inline constexpr int TaylorIndex(int i, int j) {
  const int degree = TaylorBox::kDegree[i] + TaylorBox::kDegree[j];
  if (degree > 3) return -1;
  constexpr int kFirst[4] = {0, 1, 3, 6};
  return kFirst[degree] + degree - TaylorBox::kInX[i] - TaylorBox::kInX[j];
}

namespace taylor {

// f(i, j, index of the product) for all pairs of monomials whose product counts, from the degree
// `least` of both on.
template <class F>
void ForEachPair(int least, F&& f) {
  for (int i = least > 0 ? 1 : 0; i < TaylorBox::kSize; ++i) {
    for (int j = least > 0 ? 1 : 0; j < TaylorBox::kSize; ++j) {
      const int k = TaylorIndex(i, j);
      if (k < 0) break;
      f(static_cast<std::size_t>(i), static_cast<std::size_t>(j), static_cast<std::size_t>(k));
    }
  }
}

}  // namespace taylor

inline TaylorBox operator-(const TaylorBox& a) {
  TaylorBox out;
  for (std::size_t i = 0; i < a.c.size(); ++i) out.c[i] = -a.c[i];
  return out;
}
inline TaylorBox operator+(const TaylorBox& a, const TaylorBox& b) {
  TaylorBox out;
  for (std::size_t i = 0; i < a.c.size(); ++i) out.c[i] = a.c[i] + b.c[i];
  return out;
}
inline TaylorBox operator-(const TaylorBox& a, const TaylorBox& b) {
  TaylorBox out;
  for (std::size_t i = 0; i < a.c.size(); ++i) out.c[i] = a.c[i] - b.c[i];
  return out;
}
inline TaylorBox operator*(const TaylorBox& a, const TaylorBox& b) {
  TaylorBox out;
  // A square is narrower than a product of two numbers that could differ.
  const bool is_square = &a == &b;
  taylor::ForEachPair(0, [&](std::size_t i, std::size_t j, std::size_t k) {
    out.c[k] = out.c[k] + (is_square && i == j ? Square(a.c[i]) : a.c[i] * b.c[j]);
  });
  return out;
}

// g(a), with g's Taylor coefficients over the range of a.
inline TaylorBox Compose(const TaylorBox& a, const std::array<Interval, 4>& g) {
  TaylorBox out, square, cube;
  taylor::ForEachPair(1, [&](std::size_t i, std::size_t j, std::size_t k) {
    square.c[k] = square.c[k] + (i == j ? Square(a.c[i]) : a.c[i] * a.c[j]);
  });
  taylor::ForEachPair(1, [&](std::size_t i, std::size_t j, std::size_t k) {
    cube.c[k] = cube.c[k] + square.c[i] * a.c[j];
  });
  out.c[0] = g[0];
  for (std::size_t i = 1; i < a.c.size(); ++i) {
    out.c[i] = g[1] * a.c[i] + g[2] * square.c[i] + g[3] * cube.c[i];
  }
  return out;
}

inline TaylorBox Hull(const TaylorBox& a, const TaylorBox& b) {
  TaylorBox out;
  for (std::size_t i = 0; i < a.c.size(); ++i) out.c[i] = Hull(a.c[i], b.c[i]);
  return out;
}

inline TaylorBox Inverse(const TaylorBox& a) {
  const Interval r = Inverse(a.c[0]), r2 = Square(r);
  return Compose(a, {r, -r2, r2 * r, -Square(r2)});
}

// Of what is positive over the box; all is unknown elsewhere.
inline TaylorBox Root(const TaylorBox& a) {
  if (!(a.c[0].low > 0.0)) return TaylorBox::Whole();
  const Interval root = Root(a.c[0]), r = Inverse(root), r2 = Square(r);
  return Compose(a, {root, 0.5 * r, -0.125 * (r2 * r), 0.0625 * (Square(r2) * r)});
}

// Each coefficient times its degree: x d/dx + y d/dy.
inline TaylorBox Euler(const TaylorBox& a) {
  TaylorBox out;
  for (std::size_t i = 1; i < a.c.size(); ++i) out.c[i] = 1.0 * TaylorBox::kDegree[i] * a.c[i];
  return out;
}

// atan2(y, x): its Euler derivative is (x Ey - y Ex) / (x^2 + y^2).
inline TaylorBox Angle(const TaylorBox& y, const TaylorBox& x) {
  TaylorBox out = (x * Euler(y) - y * Euler(x)) * Inverse(x * x + y * y);
  for (std::size_t i = 1; i < out.c.size(); ++i) {
    out.c[i] = (1.0 / TaylorBox::kDegree[i]) * out.c[i];
  }
  const Interval v = y.c[0], h = x.c[0];
  const bool at_cut = h.low <= 0.0 && v.low <= 0.0 && v.high >= 0.0;
  constexpr double kHalfTurn = 3.141592653589793238;
  if (at_cut && !(v.low == 0.0 && v.high > 0.0 && h.high < 0.0)) {
    out.c[0] = Interval(-kHalfTurn, kHalfTurn);
    return out;
  }
  out.c[0] = std::atan2(v.low, h.low);
  for (const double value :
       {std::atan2(v.low, h.high), std::atan2(v.high, h.low), std::atan2(v.high, h.high)}) {
    out.c[0] = Hull(out.c[0], value);
  }
  return out;
}

// g(q) = atan(sqrt q) / sqrt q for q >= 0, which is analytic at 0. Its Taylor coefficients are
// (-1)^n times the integral of t^2n / (1 + q t^2)^(n + 1) over t in [0, 1]; they fall with q.
inline TaylorBox AngleOverTangent(const TaylorBox& q) {
  constexpr int kSteps = 64;  // of Simpson's rule: 1e-9 for q below 2
  const auto coefficient = [](int n, double at) {
    double sum = 0.0;
    for (int i = 0; i <= kSteps; ++i) {
      const double t2 = (1.0 * i / kSteps) * (1.0 * i / kSteps);
      const double weight = i == 0 || i == kSteps ? 1.0 : i % 2 == 1 ? 4.0 : 2.0;
      double value = 1.0 / (1.0 + at * t2);
      const double factor = t2 * value;
      for (int k = 0; k < n; ++k) value *= factor;
      sum += weight * value;
    }
    return sum / (3.0 * kSteps);
  };
  std::array<Interval, 4> g;
  for (int n = 0; n < 4; ++n) {
    const double near = coefficient(n, std::max(q.c[0].low, 0.0));
    const double far = coefficient(n, std::max(q.c[0].high, 0.0));
    const Interval size(far, near);
    g[static_cast<std::size_t>(n)] = n % 2 == 0 ? size : -size;
  }
  return Compose(q, g);
}

}  // namespace gsut
