// Subtracts small matrix products and blocks, which eliminating points spends most of its time on.
#pragma once

#include <cstddef>
#include <cstdint>

namespace gsut {

// out -= a b^T of column-major matrices: out (rows, columns), a (rows, inner), b (columns, inner),
// each with the distance between its columns. Sums over `inner` are in order, by fused
// multiply-adds where the instruction set has them.
void SubtractProduct(double* out, std::ptrdiff_t out_stride, const double* a,
                     std::ptrdiff_t a_stride, const double* b, std::ptrdiff_t b_stride, int rows,
                     int columns, int inner);

// Of points that the same number of images see: target[a, b] -= block(b, a)^T for each two of these
// images. Each image's row is changed by one thread, point by point: the same bits on any number of
// threads.
// Args: target (count, count, size, size); images (points, length); blocks (points, length, size,
//   length, size), of the second image and the first; all row-major.
// Throws InputError for an image that is not below `count`.
void SubtractBlocks(const std::int64_t* images, const double* blocks, std::int64_t points,
                    std::int64_t length, std::int64_t count, std::int64_t size, double* target);

}  // namespace gsut
