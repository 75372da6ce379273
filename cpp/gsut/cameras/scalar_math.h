// The names of the lens contract for double; those for Dual<N> are its friends (dual.h).
#pragma once

#include <cmath>

#include "gsut/cameras/dual.h"

namespace gsut::lenses {

inline double Sqrt(double a) { return std::sqrt(a); }
inline double Abs(double a) { return std::abs(a); }
inline double Min(double a, double b) { return b < a ? b : a; }
inline double Max(double a, double b) { return a < b ? b : a; }
inline double Atan2(double y, double x) { return std::atan2(y, x); }
inline double Atan(double a) { return std::atan(a); }
inline double Asin(double a) { return std::asin(a); }
inline double Sin(double a) { return std::sin(a); }
inline double Cos(double a) { return std::cos(a); }
inline double Tan(double a) { return std::tan(a); }
inline double Floor(double a) { return std::floor(a); }
inline double Select(bool mask, double a, double b) { return mask ? a : b; }
inline bool AndMask(bool a, bool b) { return a && b; }
inline bool OrMask(bool a, bool b) { return a || b; }

// A whole number that stands in a T.
template <class T>
int WholeOf(const T& number) {
  if constexpr (requires { number.value; }) {
    return static_cast<int>(number.value);
  } else {
    return static_cast<int>(number);
  }
}

// The entry of a table at a whole number; its derivatives are those of the entry.
template <class T, class P>
T At(const P* table, const T& index) {
  return T(table[WholeOf(index)]);
}

// An entry of a table as a T: without its derivatives if T has none.
template <class T, class P>
T EntryAs(const P& entry) {
  if constexpr (requires { T(entry); }) {
    return T(entry);
  } else {
    return T(entry.value);
  }
}

// Weighted sums of rows of a table: see contract.h.
template <class T, class P>
void SumRows(const P* table, const T& first, int stride, int rows, int columns, const T* weight,
             T* sums) {
  const P* begin = table + WholeOf(first);
  for (int k = 0; k < columns; ++k) {
    sums[k] = T(0.0);
    for (int j = 0; j < rows; ++j)
      sums[k] = sums[k] + weight[j] * EntryAs<T>(begin[j * stride + k]);
  }
}

}  // namespace gsut::lenses
