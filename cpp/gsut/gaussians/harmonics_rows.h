// Where each Gaussian's harmonics stand in memory when Gaussians may have different degrees.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "gsut/gaussians/gaussians.h"
#include "gsut/gaussians/harmonics.h"

namespace gsut {

// Gaussians in falling order of degree; each stores (degree + 1)^2 coefficients of three channels
// and no more, one row after the other. The places where the degree changes are multiples of
// kRowsTogether (or the end), so that a vector of Gaussians has one degree.
struct HarmonicsRows {
  static constexpr std::int64_t kRowsTogether = 16;

  // Rows [0, end[d]) have degree d or more; end[0] is the number of Gaussians.
  std::array<std::int64_t, kMaxShDegree + 1> end = {};

  // All rows of one degree: the array (size, coefficients, 3).
  static HarmonicsRows Uniform(std::int64_t size, int coefficients) {
    HarmonicsRows rows;
    std::fill_n(rows.end.begin(), ShDegree(coefficients) + 1, size);
    return rows;
  }

  // Whether the ends fall and lie where they may.
  bool IsValid() const {
    for (std::size_t d = 0; d < end.size(); ++d) {
      if (end[d] < 0 || (d > 0 && end[d] > end[d - 1])) return false;
      if (end[d] % kRowsTogether != 0 && end[d] != end[0]) return false;
    }
    return true;
  }

  int Degree(std::int64_t row) const {
    int degree = kMaxShDegree;
    while (degree > 0 && row >= end[static_cast<std::size_t>(degree)]) --degree;
    return degree;
  }

  int MaxDegree() const { return end[0] == 0 ? 0 : Degree(0); }

  // Floats before a row; of the row after the last: all.
  std::int64_t Offset(std::int64_t row) const {
    std::int64_t floats = 3 * row;
    for (int d = 1; d <= kMaxShDegree; ++d) {
      const std::int64_t more = 3 * (NumShCoefficients(d) - NumShCoefficients(d - 1));
      floats += more * std::min(row, end[static_cast<std::size_t>(d)]);
    }
    return floats;
  }
};

}  // namespace gsut
