// Sums of photograph and image, row by row in blocks that are added in a fixed order.
#include "gsut/loss/light.h"

#include <algorithm>
#include <array>
#include <string>
#include <vector>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"

namespace gsut {
namespace {

// Outside of these a sensor is no longer linear in light, or its noise is all there is.
constexpr float kBlack = 0.02f;
constexpr float kSaturated = 0.96f;
// Rows from one that is summed to the next, at most: neighbours add little.
constexpr std::int64_t kRowStep = 4;
// Rows that are summed of a high image, at least (and fewer than twice as many).
constexpr std::int64_t kRows = 40;
constexpr std::int64_t kBlockRows = 32;

// The values of bytes.
class Levels {
 public:
  Levels() {
    for (std::size_t b = 0; b < values_.size(); ++b) values_[b] = static_cast<float>(b) / 255.0f;
  }
  float operator()(std::uint8_t byte) const { return values_[byte]; }
  float operator()(float value) const { return value; }

 private:
  std::array<float, 256> values_;
};

void Add(const LightSums& run, LightSums* sum) {
  for (int c = 0; c < 3; ++c) {
    sum->tc[c] += run.tc[c];
    sum->cc[c] += run.cc[c];
  }
}

// Adds pixels [first, first + count). Neighbours mostly share a bin: runs of them are summed in
// registers.
template <class T>
void AddRow(const PhotometricTarget& target, const Levels& levels, const T* photograph,
            const float* image, const std::uint8_t* bins, std::int64_t first, std::int64_t count,
            LightSums* out) {
  LightSums run;
  int bin = 0;
  const std::uint8_t* const mask = target.mask();
  for (std::int64_t p = first; p < first + count; ++p) {
    if (mask != nullptr && mask[p] == 0) continue;
    const T* const pixel = photograph + 3 * p;
    const float t[3] = {levels(pixel[0]), levels(pixel[1]), levels(pixel[2])};
    if (!(std::min({t[0], t[1], t[2]}) > kBlack)) continue;
    if (!(std::max({t[0], t[1], t[2]}) < kSaturated)) continue;
    if (bins != nullptr && bins[p] != bin) {
      Add(run, &out[bin]);
      run = LightSums();
      bin = bins[p];
    }
    for (int c = 0; c < 3; ++c) {
      const float value = image[3 * p + c];
      run.tc[c] += static_cast<double>(t[c] * value);
      run.cc[c] += static_cast<double>(value * value);
    }
  }
  Add(run, &out[bin]);
}

// Of the rows that are looked at.
// A bin out of range would write beyond the sums: looked for in the same rows, before.
void CheckBins(const std::uint8_t* bins, std::int64_t width, std::int64_t height, std::int64_t step,
               int num_bins) {
  if (bins == nullptr) return;
  for (std::int64_t block = 0; block < height; block += kBlockRows) {
    for (std::int64_t row = block; row < std::min(height, block + kBlockRows); row += step) {
      if (*std::max_element(bins + row * width, bins + (row + 1) * width) < num_bins) continue;
      throw InputError("bins holds numbers from num_bins on, which is " + std::to_string(num_bins));
    }
  }
}

}  // namespace

// The gain g that minimises the sum of (T - g C)^2 is (sum of T C) / (sum of C^2): two sums a bin
// and channel, in double, over some forty rows, which is plenty for a handful of gains.
void SumLight(const PhotometricTarget& target, const float* image, const std::uint8_t* bins,
              int num_bins, LightSums* sums) {
  CheckGiven(image, "image");
  CheckArray(sums, num_bins, "sums");
  const auto reading = target.Reading();
  const std::int64_t width = target.width(), height = target.height();
  const std::int64_t step = std::clamp(height / kRows, kRowStep, kBlockRows);
  CheckBins(bins, width, height, step, num_bins);
  const std::int64_t blocks = (height + kBlockRows - 1) / kBlockRows;
  std::vector<LightSums> parts(static_cast<std::size_t>(blocks * num_bins));
  // Blocks of 32 rows have sums of their own, added in their order afterwards.
  static const Levels levels;
  ParallelFor(blocks, 1, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t block = begin; block < end; ++block) {
      LightSums* const out = &parts[static_cast<std::size_t>(block * num_bins)];
      const std::int64_t last = std::min(height, (block + 1) * kBlockRows);
      for (std::int64_t row = block * kBlockRows; row < last; row += step) {
        if (target.byte_image() != nullptr) {
          AddRow(target, levels, target.byte_image(), image, bins, row * width, width, out);
        } else {
          AddRow(target, levels, target.float_image(), image, bins, row * width, width, out);
        }
      }
    }
  });
  std::fill_n(sums, num_bins, LightSums());
  for (std::size_t i = 0; i < parts.size(); ++i) {
    Add(parts[i], &sums[i % static_cast<std::size_t>(num_bins)]);
  }
}

}  // namespace gsut
