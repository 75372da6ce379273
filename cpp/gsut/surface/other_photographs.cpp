// Blocks of points through one view after the other, until enough views have seen each.
#include "gsut/surface/other_photographs.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace gsut {
namespace {

constexpr int kBlock = 256;  // points whose samples stay in the cache
constexpr int kMost = 8;     // samples of a point
constexpr int kLanes = 16;   // values of a sample, padded so that loops over them become vectors

using Sample = std::array<float, kLanes>;
using Samples = std::array<Sample, kMost>;

// What is known of a block of points, and those of them that more views may show.
struct Block {
  std::array<Samples, kBlock> samples{};
  std::array<int, kBlock> count{};
  std::array<int, kBlock> left{};
  std::array<double, 3 * kBlock> there{};
  std::array<double, 2 * kBlock> pixels{};
  std::array<std::uint8_t, kBlock> valid{};
};

// Takes the samples of one view, from the points (size, 3) that have fewer than `most`.
void TakeSamples(const ShownView& view, const double* points, int size, double tolerance, int most,
                 Block* block) {
  int left = 0;
  for (int i = 0; i < size; ++i) {
    if (block->count[i] >= most) continue;
    const double *p = points + 3 * i, *m = view.pose.data();
    for (int row = 0; row < 3; ++row, m += 4) {
      block->there[3 * left + row] = m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3];
    }
    block->left[left++] = i;
  }
  view.camera->Project(left, block->there.data(), block->pixels.data(), block->valid.data());
  const int width = view.camera->width(), height = view.camera->height();
  for (int k = 0; k < left; ++k) {
    const double x = block->pixels[2 * k], y = block->pixels[2 * k + 1];
    if (block->valid[k] == 0 || !(x >= 0 && x < width && y >= 0 && y < height)) continue;
    const std::int64_t pixel = static_cast<std::int64_t>(y) * width + static_cast<std::int64_t>(x);
    const double* p = block->there.data() + 3 * k;
    const double distance = std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
    // An infinite distance, where the view shows nothing, is never the same.
    if (!(std::abs(view.distances[pixel] - distance) <= tolerance * distance)) continue;
    const int i = block->left[k];
    std::copy_n(view.values + kShownValues * pixel, kShownValues,
                block->samples[i][block->count[i]++].data());
  }
}

// Median of each value. Exchanges of neighbouring rows sort all values at once.
Sample FindMedians(const Samples& samples, int count) {
  Samples rows = samples;
  for (int turn = 0; turn < count; ++turn) {
    for (int r = turn % 2; r + 1 < count; r += 2) {
      for (int c = 0; c < kLanes; ++c) {
        const float a = rows[r][c], b = rows[r + 1][c];
        rows[r][c] = std::min(a, b);
        rows[r + 1][c] = std::max(a, b);
      }
    }
  }
  Sample middle;
  const Sample &low = rows[(count - 1) / 2], &high = rows[count / 2];
  for (int c = 0; c < kLanes; ++c) middle[c] = (low[c] + high[c]) / 2.0f;
  return middle;
}

// Median of the samples' mean differences of colour from the median colour.
float FindSpread(const Samples& samples, int count, const Sample& middle) {
  Samples off{};
  for (int r = 0; r < count; ++r) {
    float sum = 0.0f;
    for (int c = 0; c < 3; ++c) sum += std::abs(samples[r][c] - middle[c]);
    off[r][0] = sum / 3.0f;
  }
  return FindMedians(off, count)[0];
}

}  // namespace

// Views come nearest first, so most points have all their samples after half of them: what is left
// is projected in batches, which become smaller.
// What is not done: values between pixels; neighbours' ranges, which callers give, allow for that.
void CompareShown(std::int64_t count, const double* points, std::span<const ShownView> views,
                  double tolerance, int most, int fewest, float* medians, float* spreads,
                  std::int64_t* seen) {
  std::vector<Block> room(1);
  Block& block = room.front();
  for (std::int64_t first = 0; first < count; first += kBlock) {
    const int size = static_cast<int>(std::min<std::int64_t>(kBlock, count - first));
    block.count.fill(0);
    for (const ShownView& view : views) {
      TakeSamples(view, points + 3 * first, size, tolerance, std::min(most, kMost), &block);
    }
    for (int i = 0; i < size; ++i) {
      const std::int64_t point = first + i;
      const int number = block.count[i];
      const bool enough = number >= std::max(1, fewest);
      const Sample middle = enough ? FindMedians(block.samples[i], number) : Sample{};
      std::copy_n(middle.data(), kShownValues, medians + kShownValues * point);
      spreads[point] = enough ? FindSpread(block.samples[i], number, middle) : 0.0f;
      seen[point] = number;
    }
  }
}

}  // namespace gsut
