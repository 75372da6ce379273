// Small matrix products, which structure from motion spends most of its time on.
#pragma once

#include <cstddef>

namespace gsut {

// out -= a b^T of column-major matrices: out (rows, columns), a (rows, inner), b (columns, inner),
// each with the distance between its columns. Sums over `inner` are in order, by fused
// multiply-adds where the instruction set has them.
void SubtractProduct(double* out, std::ptrdiff_t out_stride, const double* a,
                     std::ptrdiff_t a_stride, const double* b, std::ptrdiff_t b_stride, int rows,
                     int columns, int inner);

}  // namespace gsut
