// MCMC exploration noise and regularisers.
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
constexpr double kSteepness = 100.0;
constexpr double kCentre = 0.005;
// Noise below this part of the Gaussian's largest standard deviation is left out: over 30 000 steps
// it would add up to less than 2 % of it.
constexpr double kNegligible = 1e-4;

}  // namespace

void McmcNoise(const GaussiansView<float>& params, std::int64_t size, double learning_rate,
               double noise_scale, std::uint64_t seed, std::int64_t step) {
  const double strength = learning_rate * noise_scale;
  const Rng rng(seed, RandomStream(RandomUse::kMcmcNoise, step));
  ParallelFor(size, kChunkRows, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t row = begin; row < end; ++row) {
      const double opacity = Sigmoid(static_cast<double>(params.opacity_logits[row]));
      const double gate = strength * Sigmoid(-kSteepness * (opacity - kCentre));
      const float* log_scales = params.log_scales + 3 * row;
      const double largest = ScaleFromLog(
          static_cast<double>(std::max(log_scales[0], std::max(log_scales[1], log_scales[2]))));
      if (!(gate * largest > kNegligible) || !RowIsFinite(params, row)) continue;
      const auto index = static_cast<std::uint64_t>(row) * 2;
      const auto first = rng.Normals(index), second = rng.Normals(index + 1);
      const double normal[3] = {first[0], first[1], second[0]};
      const float* q = params.quats + 4 * row;
      const double quat[4] = {q[0], q[1], q[2], q[3]};
      double rotation[9], axis_noise[3] = {0, 0, 0};
      RotationFromQuaternion(quat, rotation);
      // Sigma e = R S^2 R^T e.
      for (int axis = 0; axis < 3; ++axis) {
        for (int i = 0; i < 3; ++i) axis_noise[axis] += rotation[3 * i + axis] * normal[i];
        axis_noise[axis] *= gate * std::exp(2.0 * log_scales[axis]);
      }
      for (int i = 0; i < 3; ++i) {
        double shift = 0.0;
        for (int axis = 0; axis < 3; ++axis) shift += rotation[3 * i + axis] * axis_noise[axis];
        const double moved = params.means[3 * row + i] + shift;
        // A Gaussian so large that its noise overflows stays where it is.
        if (std::abs(moved) <= std::numeric_limits<float>::max()) {
          params.means[3 * row + i] = static_cast<float>(moved);
        }
      }
    }
  });
}

void AddMcmcRegularizer(const GaussiansView<const float>& params, std::int64_t size,
                        double opacity_weight, double scale_weight, float* dl_dopacity_logits,
                        float* dl_dlog_scales) {
  const double count = static_cast<double>(std::max<std::int64_t>(size, 1));
  const auto opacity_factor = static_cast<float>(opacity_weight / count);
  const auto scale_factor = static_cast<float>(scale_weight / (3.0 * count));
  ParallelFor(size, kChunkRows, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t row = begin; row < end; ++row) {
      const float opacity = Sigmoid(params.opacity_logits[row]);
      dl_dopacity_logits[row] += opacity_factor * SigmoidDerivative(opacity);
      for (std::int64_t i = 3 * row; i < 3 * row + 3; ++i) {
        dl_dlog_scales[i] += scale_factor * ScaleFromLog(params.log_scales[i]);
      }
    }
  });
}

}  // namespace gsut
