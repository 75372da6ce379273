// Brightness first, from some of the pixels; then the errors of all.
#include "gsut/loss/pixel_errors.h"

#include <array>
#include <cmath>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

constexpr std::int64_t kGrain = 1 << 14;
constexpr std::int64_t kStep = 11;  // every eleventh pixel says how bright the photograph is

bool Counts(const float* gradient) {
  return gradient[0] != 0.0f || gradient[1] != 0.0f || gradient[2] != 0.0f;
}

// A photograph's values (H, W, 3), and the factors that make light of them.
template <class T>
struct Photograph {
  const T* values;
  const float* inverse_falloff;  // (H, W, 3), null: 1
  std::array<float, 3> factors;

  float Lit(std::int64_t pixel, std::size_t c) const {
    const std::size_t i = 3 * static_cast<std::size_t>(pixel) + c;
    const float value = factors[c] * static_cast<float>(values[i]);
    return inverse_falloff == nullptr ? value : value * inverse_falloff[i];
  }
};

// Makes each channel as bright as the image, in one thread.
// The factor is sum of C^2 over sum of C T, with C the image and T the photograph in its light: the
// inverse of the gain that fits the photograph by the image (light.h).
template <class T>
void FitBrightness(const float* image, const float* gradient, std::int64_t pixels,
                   Photograph<T>* photograph) {
  std::array<double, 3> products{}, squares{};
  for (std::int64_t p = 0; p < pixels; p += kStep) {
    if (!Counts(gradient + 3 * p)) continue;
    for (std::size_t c = 0; c < 3; ++c) {
      const float value = image[3 * static_cast<std::size_t>(p) + c];
      products[c] += static_cast<double>(value * photograph->Lit(p, c));
      squares[c] += static_cast<double>(value * value);
    }
  }
  for (std::size_t c = 0; c < 3; ++c) {
    if (products[c] > 0.0) photograph->factors[c] *= static_cast<float>(squares[c] / products[c]);
  }
}

// |C - g T| averaged over channels; 0 where the loss has no gradient.
template <class T>
void Errors(Photograph<T> photograph, const float* image, const float* gradient,
            std::int64_t pixels, float* errors) {
  FitBrightness(image, gradient, pixels, &photograph);
  ParallelFor(pixels, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t p = begin; p < end; ++p) {
      const float* shown = image + 3 * p;
      const float sum = std::abs(shown[0] - photograph.Lit(p, 0)) +
                        std::abs(shown[1] - photograph.Lit(p, 1)) +
                        std::abs(shown[2] - photograph.Lit(p, 2));
      errors[p] = Counts(gradient + 3 * p) ? sum * (1.0f / 3.0f) : 0.0f;
    }
  });
}

}  // namespace

void PixelErrors(const PhotometricTarget& target, const float* image, const float* gradient,
                 float* errors) {
  const auto reading = target.Reading();
  const std::int64_t pixels = target.width() * target.height();
  std::array<float, 3> factors = target.inverse_gain();
  if (target.byte_image() == nullptr) {
    Errors<float>({target.float_image(), target.inverse_falloff(), factors}, image, gradient,
                  pixels, errors);
    return;
  }
  for (float& factor : factors) factor /= 255.0f;
  Errors<std::uint8_t>({target.byte_image(), target.inverse_falloff(), factors}, image, gradient,
                       pixels, errors);
}

}  // namespace gsut
