// Sums of photograph and image, row by row in blocks that are added in a fixed order.
#include "gsut/loss/light.h"

#include <algorithm>
#include <vector>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

// Outside of these a sensor is no longer linear in light, or its noise is all there is.
constexpr float kBlack = 0.02f, kSaturated = 0.96f;
constexpr std::int64_t kRowStep = 4;  // neighbouring rows tell the same
constexpr std::int64_t kBlockRows = 32;

}  // namespace

void SumLight(const PhotometricTarget& target, const float* image, const std::uint8_t* bins,
              int num_bins, LightSums* sums) {
  const std::int64_t width = target.width(), height = target.height();
  const std::int64_t blocks = (height + kBlockRows - 1) / kBlockRows;
  std::vector<LightSums> parts(static_cast<std::size_t>(blocks * num_bins));
  ParallelFor(blocks, 1, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t block = begin; block < end; ++block) {
      LightSums* const out = &parts[static_cast<std::size_t>(block * num_bins)];
      const std::int64_t last = std::min(height, (block + 1) * kBlockRows);
      for (std::int64_t row = block * kBlockRows; row < last; row += kRowStep) {
        for (std::int64_t p = row * width; p < (row + 1) * width; ++p) {
          if (target.mask() != nullptr && target.mask()[p] == 0) continue;
          float t[3];
          for (int c = 0; c < 3; ++c) {
            t[c] = target.byte_image() != nullptr
                       ? static_cast<float>(target.byte_image()[3 * p + c]) / 255.0f
                       : target.float_image()[3 * p + c];
          }
          if (!(std::min({t[0], t[1], t[2]}) > kBlack)) continue;
          if (!(std::max({t[0], t[1], t[2]}) < kSaturated)) continue;
          LightSums& sum = out[bins == nullptr ? 0 : bins[p]];
          for (int c = 0; c < 3; ++c) {
            const float value = image[3 * p + c];
            sum.tc[c] += static_cast<double>(t[c] * value);
            sum.cc[c] += static_cast<double>(value * value);
          }
        }
      }
    }
  });
  std::fill_n(sums, num_bins, LightSums());
  for (std::size_t i = 0; i < parts.size(); ++i) {
    LightSums& sum = sums[i % static_cast<std::size_t>(num_bins)];
    for (int c = 0; c < 3; ++c) {
      sum.tc[c] += parts[i].tc[c];
      sum.cc[c] += parts[i].cc[c];
    }
  }
}

}  // namespace gsut
