// Forward-mode derivatives: a value with its gradient along N directions.
#pragma once

#include <array>
#include <cmath>

namespace gsut {

// value + sum of grad[i] e_i with e_i e_j = 0. Comparisons look at the value only.
template <int N>
struct Dual {
  double value = 0.0;
  std::array<double, N> grad = {};

  Dual() = default;
  explicit Dual(double constant) : value(constant) {}
  // The variable number `direction`.
  Dual(double v, int direction) : value(v) { grad[direction] = 1.0; }

  // f(value) with derivative f'(value).
  Dual Chain(double f, double df) const {
    Dual out(f);
    for (int i = 0; i < N; ++i) out.grad[i] = df * grad[i];
    return out;
  }
  // f(a, b) with partial derivatives fa, fb.
  static Dual Chain(double f, const Dual& a, double fa, const Dual& b, double fb) {
    Dual out(f);
    for (int i = 0; i < N; ++i) out.grad[i] = fa * a.grad[i] + fb * b.grad[i];
    return out;
  }

  friend Dual operator-(const Dual& a) { return a.Chain(-a.value, -1.0); }
  friend Dual operator+(const Dual& a, const Dual& b) {
    return Chain(a.value + b.value, a, 1.0, b, 1.0);
  }
  friend Dual operator-(const Dual& a, const Dual& b) {
    return Chain(a.value - b.value, a, 1.0, b, -1.0);
  }
  friend Dual operator*(const Dual& a, const Dual& b) {
    return Chain(a.value * b.value, a, b.value, b, a.value);
  }
  friend Dual operator/(const Dual& a, const Dual& b) {
    const double quotient = a.value / b.value;
    return Chain(quotient, a, 1.0 / b.value, b, -quotient / b.value);
  }

  friend bool operator<(const Dual& a, const Dual& b) { return a.value < b.value; }
  friend bool operator<=(const Dual& a, const Dual& b) { return a.value <= b.value; }
  friend bool operator>(const Dual& a, const Dual& b) { return a.value > b.value; }
  friend bool operator>=(const Dual& a, const Dual& b) { return a.value >= b.value; }

  friend Dual Sqrt(const Dual& a) {
    const double root = std::sqrt(a.value);
    return a.Chain(root, 0.5 / root);
  }
  friend Dual Abs(const Dual& a) { return a.value < 0.0 ? -a : a; }
  friend Dual Min(const Dual& a, const Dual& b) { return b.value < a.value ? b : a; }
  friend Dual Max(const Dual& a, const Dual& b) { return a.value < b.value ? b : a; }
  friend Dual Atan2(const Dual& y, const Dual& x) {
    const double square = x.value * x.value + y.value * y.value;
    return Chain(std::atan2(y.value, x.value), y, x.value / square, x, -y.value / square);
  }
  friend Dual Atan(const Dual& a) {
    return a.Chain(std::atan(a.value), 1.0 / (1.0 + a.value * a.value));
  }
  friend Dual Asin(const Dual& a) {
    return a.Chain(std::asin(a.value), 1.0 / std::sqrt((1.0 - a.value) * (1.0 + a.value)));
  }
  friend Dual Sin(const Dual& a) { return a.Chain(std::sin(a.value), std::cos(a.value)); }
  friend Dual Cos(const Dual& a) { return a.Chain(std::cos(a.value), -std::sin(a.value)); }
  friend Dual Tan(const Dual& a) {
    const double tangent = std::tan(a.value);
    return a.Chain(tangent, 1.0 + tangent * tangent);
  }
  friend Dual Floor(const Dual& a) { return Dual(std::floor(a.value)); }
  friend Dual Select(bool mask, const Dual& a, const Dual& b) { return mask ? a : b; }
};

}  // namespace gsut
