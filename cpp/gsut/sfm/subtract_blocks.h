// Sums of blocks between pairs of images, as normal equations lose them when points are eliminated.
#pragma once

#include <cstdint>

namespace gsut {

// Of points that the same number of images see: target[a, b] -= block(b, a)^T for each two of these
// images. Each image's row is changed by one thread, point by point: the same bits on any number of
// threads.
// Args: target (count, count, size, size); images (points, length); blocks (points, length, size,
//   length, size), of the second image and the first; all row-major.
// Throws InputError for an image that is not below `count`.
void SubtractBlocks(const std::int64_t* images, const double* blocks, std::int64_t points,
                    std::int64_t length, std::int64_t count, std::int64_t size, double* target);

}  // namespace gsut
