// Each image's row of blocks is changed by one thread.
#include "gsut/sfm/subtract_blocks.h"

#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"

namespace gsut {

void SubtractBlocks(const std::int64_t* images, const double* blocks, std::int64_t points,
                    std::int64_t length, std::int64_t count, std::int64_t size, double* target) {
  // Of each image its places in `images`, in the order of points: the order of each block's sum.
  std::vector<std::vector<std::int64_t>> places(count);
  for (std::int64_t at = 0; at < points * length; ++at) {
    if (images[at] < 0 || images[at] >= count) {
      throw InputError("images holds " + std::to_string(images[at]) + "; there are " +
                       std::to_string(count));
    }
    places[images[at]].push_back(at);
  }
  // No two images share a row, so that threads never change the same number.
  ParallelFor(count, 1, [&](std::int64_t image, std::int64_t) {
    for (const std::int64_t place : places[image]) {
      const std::int64_t point = place / length, own = place % length;
      const double* block = blocks + (point * length * size * length + own) * size;
      // The block of another image and this one is read row by row, and written transposed.
      for (std::int64_t other = 0; other < length; ++other) {
        const std::int64_t column = images[point * length + other];
        double* out = target + (image * count + column) * size * size;
        for (std::int64_t k = 0; k < size; ++k, block += length * size) {
          for (std::int64_t i = 0; i < size; ++i) out[i * size + k] -= block[i];
        }
      }
    }
  });
}

}  // namespace gsut
