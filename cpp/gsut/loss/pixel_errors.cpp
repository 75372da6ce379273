// Brightness first, from a fifth of the pixels; then the errors of all.
#include "gsut/loss/pixel_errors.h"

#include <array>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

constexpr std::int64_t kGrain = 1 << 14;
constexpr std::int64_t kStep = 5;  // every fifth pixel says how bright the photograph is

bool Counts(const float* gradient, std::int64_t pixel) {
  const float* g = gradient + 3 * pixel;
  return g[0] != 0.0f || g[1] != 0.0f || g[2] != 0.0f;
}

// Factors of the photograph's channels that bring it closest to the image, in one thread.
std::array<float, 3> Brightness(const PhotometricTarget& target, const float* image,
                                const float* gradient) {
  std::array<double, 3> products{}, squares{};
  for (std::int64_t p = 0; p < target.width() * target.height(); p += kStep) {
    if (!Counts(gradient, p)) continue;
    for (std::size_t c = 0; c < 3; ++c) {
      const std::int64_t i = 3 * p + static_cast<std::int64_t>(c);
      const float value = LitValue(target, i);
      products[c] += static_cast<double>(value * image[i]);
      squares[c] += static_cast<double>(image[i] * image[i]);
    }
  }
  std::array<float, 3> factors;
  for (std::size_t c = 0; c < 3; ++c) {
    factors[c] = products[c] > 0.0 ? static_cast<float>(squares[c] / products[c]) : 1.0f;
  }
  return factors;
}

}  // namespace

void PixelErrors(const PhotometricTarget& target, const float* image, const float* gradient,
                 float* errors) {
  const auto reading = target.Reading();
  const std::array<float, 3> factors = Brightness(target, image, gradient);
  ParallelFor(target.width() * target.height(), kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t p = begin; p < end; ++p) {
      float sum = 0.0f;
      for (std::size_t c = 0; c < 3; ++c) {
        const std::int64_t i = 3 * p + static_cast<std::int64_t>(c);
        sum += std::abs(image[i] - factors[c] * LitValue(target, i));
      }
      errors[p] = Counts(gradient, p) ? sum / 3.0f : 0.0f;
    }
  });
}

}  // namespace gsut
