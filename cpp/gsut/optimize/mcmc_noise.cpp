// MCMC exploration noise.
#include <algorithm>
#include <cmath>
#include <limits>

#include "gsut/base/parallel.h"
#include "gsut/base/rng.h"
#include "gsut/gaussians/activations.h"
#include "gsut/optimize/mcmc.h"

namespace gsut {
namespace {

constexpr std::int64_t kChunkRows = 1024;
// The gate sigmoid(-kSteepness (opacity - kCentre)) of the paper.
constexpr float kSteepness = 100.0f;
constexpr float kCentre = 0.005f;
// Noise below this part of the Gaussian's largest standard deviation is left out: over 30 000 steps
// it would add up to less than 2 % of it.
constexpr float kNegligible = 1e-4f;

// Langevin's term: mean += rate noise_scale gate Sigma e, with e standard normal. Gaussians that
// are nearly transparent explore, within their own shape, what no gradient would show them. Three
// standard normal values by Box-Muller in float: 24-bit uniforms reach 5.8 standard deviations, and
// noise needs no more digits.
void DrawNormals(const Rng& rng, std::int64_t index, float* normals) {
  constexpr float kUnit = 0x1.0p-24f;
  constexpr float kTwoPi = 6.28318530717958648f;
  const auto words = rng.Words(static_cast<std::uint64_t>(index));
  float radius[2], angle[2];
  for (std::size_t i = 0; i < 2; ++i) {
    radius[i] = std::sqrt(-2.0f * std::log(static_cast<float>((words[2 * i] >> 8) + 1) * kUnit));
    angle[i] = kTwoPi * (static_cast<float>(words[2 * i + 1] >> 8) * kUnit);
  }
  normals[0] = radius[0] * std::cos(angle[0]);
  normals[1] = radius[0] * std::sin(angle[0]);
  normals[2] = radius[1] * std::cos(angle[1]);
}

}  // namespace

void McmcNoise(const GaussiansView<float>& params, std::int64_t size, double learning_rate,
               double noise_scale, std::uint64_t seed, std::int64_t step) {
  const auto strength = static_cast<float>(learning_rate * noise_scale);
  const Rng rng(seed, RandomStream(RandomUse::kMcmcNoise, step));
  ParallelFor(size, kChunkRows, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t row = begin; row < end; ++row) {
      const float opacity = Sigmoid(params.opacity_logits[row]);
      const float gate = strength * Sigmoid(-kSteepness * (opacity - kCentre));
      const float* log_scales = params.log_scales + 3 * row;
      const float largest =
          ScaleFromLog(std::max(log_scales[0], std::max(log_scales[1], log_scales[2])));
      if (!(gate * largest > kNegligible)) continue;
      float normals[3], rotation[9], along[3];
      DrawNormals(rng, row, normals);
      RotationFromQuaternion(params.quats + 4 * row, rotation);
      // Sigma e = R S^2 R^T e.
      for (int axis = 0; axis < 3; ++axis) {
        const float scale = ScaleFromLog(log_scales[axis]);
        along[axis] = gate * scale * scale *
                      (rotation[axis] * normals[0] + rotation[3 + axis] * normals[1] +
                       rotation[6 + axis] * normals[2]);
      }
      for (int i = 0; i < 3; ++i) {
        const float* r = rotation + 3 * i;
        const float moved =
            params.means[3 * row + i] + (r[0] * along[0] + r[1] * along[1] + r[2] * along[2]);
        // What is not finite, or so large that its noise overflows, stays where it is.
        if (std::abs(moved) <= std::numeric_limits<float>::max()) params.means[3 * row + i] = moved;
      }
    }
  });
}

}  // namespace gsut
