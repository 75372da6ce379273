// Errors of pixels, their median by a histogram, and sums over neighbourhoods by an integral image.
#include "gsut/loss/trim.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

constexpr int kLevels = 2048;  // of the histogram of errors in [0, 1]
constexpr std::int64_t kRows = 16;

// Whether the mask lets a pixel count.
bool Counts(const PhotometricTarget& target, std::int64_t pixel) {
  return target.mask() == nullptr || target.mask()[pixel] != 0;
}

// Mean absolute difference of the channels, as a level.
int ErrorLevel(const PhotometricTarget& target, const float* image, std::int64_t pixel) {
  float sum = 0.0f;
  for (std::int64_t c = 0; c < 3; ++c) {
    const std::int64_t i = 3 * pixel + c;
    float value = target.byte_image() != nullptr
                      ? static_cast<float>(target.byte_image()[i]) / 255.0f
                      : target.float_image()[i];
    value *= target.inverse_gain()[static_cast<std::size_t>(c)];
    if (target.inverse_falloff() != nullptr) value *= target.inverse_falloff()[i];
    sum += std::abs(image[i] - value);
  }
  return std::min(kLevels - 1, static_cast<int>(sum * (static_cast<float>(kLevels) / 3.0f)));
}

}  // namespace

// Three passes: 1. each pixel's error as one of 2048 levels, with a histogram a block of rows; 2.
// the median from the histograms, and an integral image of the pixels far above it; 3. each pixel's
// neighbourhood, four look-ups whatever its radius.
// What is not done: the median is of one view, so that a view in which most is new trims nothing.
std::int64_t TrimGradient(const PhotometricTarget& target, const float* image,
                          const TrimOptions& options, float* gradient) {
  const auto reading = target.Reading();
  const std::int64_t width = target.width(), height = target.height();
  // Blocks of rows have a histogram each: counts are whole numbers, so that their order is free.
  const std::int64_t blocks = (height + kRows - 1) / kRows;
  std::vector<std::uint16_t> levels(static_cast<std::size_t>(width * height), 0);
  std::vector<std::array<std::int64_t, kLevels>> counts(static_cast<std::size_t>(blocks));
  ParallelFor(blocks, 1, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t block = begin; block < end; ++block) {
      auto& of_block = counts[static_cast<std::size_t>(block)];
      of_block.fill(0);
      const std::int64_t last = std::min(height, (block + 1) * kRows) * width;
      for (std::int64_t p = block * kRows * width; p < last; ++p) {
        if (!Counts(target, p)) continue;
        const int level = ErrorLevel(target, image, p);
        levels[static_cast<std::size_t>(p)] = static_cast<std::uint16_t>(level);
        ++of_block[static_cast<std::size_t>(level)];
      }
    }
  });
  // The median by counting: the first level that half of the pixels do not exceed.
  std::int64_t below = 0;
  int median = 0;
  for (; median < kLevels; ++median) {
    for (const auto& of_block : counts) below += of_block[static_cast<std::size_t>(median)];
    if (2 * below >= target.pixels()) break;
  }
  const double limit = options.over_median * (median + 1);
  // Summed-area table (Crow, 1984): the count in a rectangle is bottom right - bottom left - top
  // right + top left, with
  // differing[r][c]: pixels that differ above row r and left of column c.
  const std::int64_t stride = width + 1;
  std::vector<std::int32_t> differing(static_cast<std::size_t>(stride * (height + 1)), 0);
  for (std::int64_t row = 0; row < height; ++row) {
    std::int32_t in_row = 0;
    for (std::int64_t column = 0; column < width; ++column) {
      in_row += levels[static_cast<std::size_t>(row * width + column)] > limit ? 1 : 0;
      differing[static_cast<std::size_t>((row + 1) * stride + column + 1)] =
          differing[static_cast<std::size_t>(row * stride + column + 1)] + in_row;
    }
  }
  std::vector<std::int64_t> trimmed(static_cast<std::size_t>(blocks), 0);
  ParallelFor(blocks, 1, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t row = begin * kRows; row < std::min(height, end * kRows); ++row) {
      const std::int64_t top = std::max<std::int64_t>(0, row - options.radius) * stride;
      const std::int64_t bottom = std::min(height, row + options.radius + 1) * stride;
      // A pixel is trimmed where enough of its neighbourhood differs: noise alone is spread out.
      for (std::int64_t column = 0; column < width; ++column) {
        const std::int64_t left = std::max<std::int64_t>(0, column - options.radius);
        const std::int64_t right = std::min(width, column + options.radius + 1);
        const auto at = [&](std::int64_t i) { return differing[static_cast<std::size_t>(i)]; };
        const int count = at(bottom + right) - at(bottom + left) - at(top + right) + at(top + left);
        const std::int64_t rows = (bottom - top) / stride;
        const auto area = static_cast<double>(rows * (right - left));
        if (count <= options.share * area) continue;
        std::fill_n(gradient + 3 * (row * width + column), 3, 0.0f);
        ++trimmed[static_cast<std::size_t>(row / kRows)];
      }
    }
  });
  std::int64_t sum = 0;
  for (const std::int64_t count : trimmed) sum += count;
  return sum;
}

}  // namespace gsut
