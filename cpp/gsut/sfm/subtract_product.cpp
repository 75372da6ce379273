// Blocks of three vectors of rows by four columns stay in registers.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/sfm/subtract_product.cpp"
#include "gsut/base/hwy_targets.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <vector>

#include "gsut/sfm/subtract_product.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

// A block of sums: 3 x 4 accumulators, 3 vectors of `a` and one broadcast value of `b` fill the 16
// registers of AVX2, and 12 independent sums hide the latency of a fused multiply-add.
constexpr int kVectors = 3;
constexpr int kColumns = 4;

struct Matrices {
  double* out;
  const double *a, *b;
  std::ptrdiff_t out_stride, a_stride, b_stride;
  int inner;
};

// The block at a row and a column; the last of its vectors holds `rest` rows (0: all of them).
template <int kOwnVectors, int kOwnColumns>
HWY_INLINE void Block(const Matrices& m, int row, int column, int rest) {
  const hn::ScalableTag<double> d;
  using V = hn::Vec<decltype(d)>;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const auto some = hn::FirstN(d, rest > 0 ? rest : lanes);
  // Vectors of two have no masked load that takes any address, nor a masked store that leaves the
  // other row alone: one row is a scalar there.
  const bool is_scalar = hn::MaxLanes(d) == 2 && rest == 1;
  const auto load = [&](const double* from, int v) HWY_ATTR {
    if (v + 1 < kOwnVectors) return hn::LoadU(d, from + v * lanes);
    if (is_scalar) return hn::Set(d, from[v * lanes]);
    return hn::MaxLanes(d) == 2 ? hn::LoadU(d, from + v * lanes)
                                : hn::MaskedLoad(some, d, from + v * lanes);
  };
  V sums[kOwnVectors][kOwnColumns];
  double* out = m.out + row + column * m.out_stride;
  for (int c = 0; c < kOwnColumns; ++c) {
    for (int v = 0; v < kOwnVectors; ++v) sums[v][c] = load(out + c * m.out_stride, v);
  }
  const double *a = m.a + row, *b = m.b + column;
  // An outer product of a column of a and one of b each time: loads are few beside the products.
  for (int k = 0; k < m.inner; ++k, a += m.a_stride, b += m.b_stride) {
    V left[kOwnVectors];
    for (int v = 0; v < kOwnVectors; ++v) left[v] = load(a, v);
    for (int c = 0; c < kOwnColumns; ++c) {
      const V right = hn::Set(d, b[c]);
      for (int v = 0; v < kOwnVectors; ++v) sums[v][c] = hn::NegMulAdd(left[v], right, sums[v][c]);
    }
  }
  // Rows past the end belong to other tiles: the last vector is stored through its mask.
  for (int c = 0; c < kOwnColumns; ++c) {
    for (int v = 0; v + 1 < kOwnVectors; ++v) {
      hn::StoreU(sums[v][c], d, out + c * m.out_stride + v * lanes);
    }
    double* last = out + c * m.out_stride + (kOwnVectors - 1) * lanes;
    if (is_scalar) {
      *last = hn::GetLane(sums[kOwnVectors - 1][c]);
    } else {
      hn::BlendedStore(sums[kOwnVectors - 1][c], some, d, last);
    }
  }
}

// All rows of a group of columns, in blocks of three vectors.
template <int kOwnColumns>
HWY_INLINE void Columns(const Matrices& m, int rows, int column) {
  const int lanes = static_cast<int>(hn::Lanes(hn::ScalableTag<double>()));
  int row = 0;
  for (; row + kVectors * lanes <= rows; row += kVectors * lanes) {
    Block<kVectors, kOwnColumns>(m, row, column, 0);
  }
  // The rest of the rows takes as few vectors as hold it, the last one masked.
  const int left = rows - row;
  if (left > 2 * lanes) {
    Block<3, kOwnColumns>(m, row, column, left - 2 * lanes);
  } else if (left > lanes) {
    Block<2, kOwnColumns>(m, row, column, left - lanes);
  } else if (left > 0) {
    Block<1, kOwnColumns>(m, row, column, left);
  }
}

// Columns four at a time, then two: blocks of poses have six.
HWY_INLINE void AllColumns(const Matrices& m, int rows, int columns) {
  int column = 0;
  for (; column + kColumns <= columns; column += kColumns) Columns<kColumns>(m, rows, column);
  if (column + 2 <= columns) {
    Columns<2>(m, rows, column);
    column += 2;
  }
  if (column < columns) Columns<1>(m, rows, column);
}

// The same rows of a m, in a vector for each column.
template <int kRows, int kInner, class D>
HWY_INLINE void Scale(D d, const double* a, const double* m, hn::Vec<D>* scaled) {
  for (int k = 0; k < kInner; ++k, m += kInner) {
    scaled[k] = hn::Mul(hn::LoadU(d, a), hn::Set(d, m[0]));
    for (int j = 1; j < kInner; ++j) {
      scaled[k] = hn::MulAdd(hn::LoadU(d, a + j * kRows), hn::Set(d, m[j]), scaled[k]);
    }
  }
}

// The same rows of a column of out, from those of a m and a row of b.
template <int kInner, class D>
HWY_INLINE void SubtractColumn(D d, const hn::Vec<D>* scaled, const hn::Vec<D>* right,
                               double* out) {
  auto sum = hn::LoadU(d, out);
  for (int k = 0; k < kInner; ++k) sum = hn::NegMulAdd(scaled[k], right[k], sum);
  hn::StoreU(sum, d, out);
}

// Terms of a fixed number of rows, for which a m stays in registers. Six rows are vectors of four
// and of two: a load of what was just stored through a mask would wait.
template <int kRows, int kInner>
HWY_INLINE void FixedTerms(std::span<const ProductTerm> terms, std::ptrdiff_t out_stride,
                           const double* a, const double* m) {
  const hn::CappedTag<double, 4> wide;
  const hn::CappedTag<double, 2> narrow;
  constexpr int kLanes = static_cast<int>(hn::MaxLanes(wide));
  constexpr int kWide = kRows / kLanes;
  constexpr bool kHasRest = kRows % kLanes != 0;
  hn::Vec<decltype(wide)> scaled[kWide][kInner];
  hn::Vec<decltype(narrow)> rest[kInner];
  for (int v = 0; v < kWide; ++v) Scale<kRows, kInner>(wide, a + v * kLanes, m, scaled[v]);
  if (kHasRest) Scale<kRows, kInner>(narrow, a + kWide * kLanes, m, rest);
  for (const ProductTerm& term : terms) {
    double* out = term.out;
    for (int c = 0; c < term.columns; ++c, out += out_stride) {
      hn::Vec<decltype(wide)> right[kInner];
      for (int k = 0; k < kInner; ++k) right[k] = hn::Set(wide, term.b[k * term.columns + c]);
      for (int v = 0; v < kWide; ++v) {
        SubtractColumn<kInner>(wide, scaled[v], right, out + v * kLanes);
      }
      if constexpr (kHasRest) {
        hn::Vec<decltype(narrow)> half[kInner];
        for (int k = 0; k < kInner; ++k) half[k] = hn::LowerHalf(narrow, right[k]);
        SubtractColumn<kInner>(narrow, rest, half, out + kWide * kLanes);
      }
    }
  }
}

// Any number of rows.
void AnyTerms(std::span<const ProductTerm> terms, std::ptrdiff_t out_stride, const double* a,
              const double* m, int rows, int inner) {
  std::vector<double> scaled(static_cast<std::size_t>(rows) * inner, 0.0);
  for (int k = 0; k < inner; ++k) {
    for (int j = 0; j < inner; ++j) {
      for (int row = 0; row < rows; ++row) {
        scaled[k * rows + row] += a[j * rows + row] * m[k * inner + j];
      }
    }
  }
  for (const ProductTerm& term : terms) {
    const Matrices all = {term.out, scaled.data(), term.b, out_stride, rows, term.columns, inner};
    AllColumns(all, rows, term.columns);
  }
}

}  // namespace

void Subtract(double* out, std::ptrdiff_t out_stride, const double* a, std::ptrdiff_t a_stride,
              const double* b, std::ptrdiff_t b_stride, int rows, int columns, int inner) {
  AllColumns({out, a, b, out_stride, a_stride, b_stride, inner}, rows, columns);
}

void SubtractTerms(std::span<const ProductTerm> terms, std::ptrdiff_t out_stride, const double* a,
                   const double* m, int rows, int inner) {
  if (rows == 6 && inner == 3) return FixedTerms<6, 3>(terms, out_stride, a, m);
  if (rows == 6 && inner == 2) return FixedTerms<6, 2>(terms, out_stride, a, m);
  if (rows == 12 && inner == 3) return FixedTerms<12, 3>(terms, out_stride, a, m);
  if (rows == 12 && inner == 2) return FixedTerms<12, 2>(terms, out_stride, a, m);
  AnyTerms(terms, out_stride, a, m, rows, inner);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {

HWY_EXPORT(Subtract);
HWY_EXPORT(SubtractTerms);

void SubtractProduct(double* out, std::ptrdiff_t out_stride, const double* a,
                     std::ptrdiff_t a_stride, const double* b, std::ptrdiff_t b_stride, int rows,
                     int columns, int inner) {
  HWY_DYNAMIC_DISPATCH(Subtract)
  (out, out_stride, a, a_stride, b, b_stride, rows, columns, inner);
}

void SubtractProducts(std::span<const ProductTerm> terms, std::ptrdiff_t out_stride,
                      const double* a, const double* m, int rows, int inner) {
  HWY_DYNAMIC_DISPATCH(SubtractTerms)(terms, out_stride, a, m, rows, inner);
}

}  // namespace gsut
#endif  // HWY_ONCE
