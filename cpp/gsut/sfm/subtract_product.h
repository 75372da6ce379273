// Small matrix products, which structure from motion spends most of its time on.
#pragma once

#include <cstddef>
#include <span>

namespace gsut {

// out -= a b^T of column-major matrices: out (rows, columns), a (rows, inner), b (columns, inner),
// each with the distance between its columns. Sums over `inner` are in order, by fused
// multiply-adds where the instruction set has them.
void SubtractProduct(double* out, std::ptrdiff_t out_stride, const double* a,
                     std::ptrdiff_t a_stride, const double* b, std::ptrdiff_t b_stride, int rows,
                     int columns, int inner);

// One of several products with the same left side: out (rows, columns), b (columns, inner), whose
// columns lie beside each other.
struct ProductTerm {
  double* out;
  const double* b;
  int columns;
};

// out -= a m b^T for each term in turn: a (rows, inner) and m (inner, inner), column-major, their
// columns beside each other. Fast for 6 and 12 rows, a pose without and with its velocity.
void SubtractProducts(std::span<const ProductTerm> terms, std::ptrdiff_t out_stride,
                      const double* a, const double* m, int rows, int inner);

}  // namespace gsut
