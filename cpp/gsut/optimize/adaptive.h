// Adaptive density control: clone or split what the loss pulls at, prune what nobody sees.
//
// Source: Kerbl et al., "3D Gaussian splatting for real-time radiance field rendering", SIGGRAPH
// 2023, section 5; gradient proxy for evaluation in 3D: |dL/dmean| x distance / 2 (3dgrut).
#pragma once

#include <cstdint>
#include <vector>

#include "gsut/optimize/training_state.h"

namespace gsut {

struct AdaptiveOptions {
  double gradient_threshold = 2e-4;  // mean proxy above which a Gaussian is cloned or split (3DGS)
  // World units: largest standard deviation up to which it is cloned, not split. 3DGS: 0.01 x
  // extent.
  double clone_scale = 0.01;
  double prune_opacity = 0.005;  // below: pruned (3DGS)
  // World units: largest standard deviation above which it is pruned. Infinity: no limit.
  double max_scale = 1e30;
  // If growth would exceed this, only the rows with the largest proxies grow. 0: no limit.
  std::int64_t max_gaussians = 0;
};

enum class AdaptiveAction : std::uint8_t { kKeep = 0, kPrune = 1, kClone = 2, kSplit = 3 };

struct AdaptivePlan {
  std::vector<AdaptiveAction> actions;  // one a row
  std::int64_t pruned = 0;
  std::int64_t cloned = 0;
  std::int64_t split = 0;
  // Rows afterwards, which is the capacity that ApplyAdaptive needs.
  std::int64_t SizeAfter() const {
    return static_cast<std::int64_t>(actions.size()) - pruned + cloned + split;
  }
};

// Decides for each of the first `size` rows. gradient_sums, counts: what AccumulateDensity
// gathered; a row never seen has proxy 0. Rows with a parameter that is not finite are pruned.
AdaptivePlan PlanAdaptive(const GaussiansView<float>& params, std::int64_t size,
                          const float* gradient_sums, const std::int32_t* counts,
                          const AdaptiveOptions& options);

// Carries a plan out in place and returns the new size. Pruned rows go first, the others keep their
// order and moments; copies are appended in the order of their parents with zero moments.
//   clone: an exact copy.
//   split: parent and copy both drawn from the parent's Gaussian, scales divided by 1.6, moments 0.
// Random numbers depend on (seed, step, parent row before pruning). Throws InputError if the plan
// is for another size or the capacity is less than SizeAfter().
std::int64_t ApplyAdaptive(const TrainingState& state, const AdaptivePlan& plan, std::uint64_t seed,
                           std::int64_t step);

// Lowers every opacity above max_opacity to it and zeroes the opacity moments of all rows (3DGS:
// 0.01 every 3000 steps).
void ResetOpacities(const TrainingState& state, double max_opacity);

// Gathers, over the rows with visible != 0 (null: all), what densification decides on:
//   max[i] = max(max[i], |g_i| d_i),  sum[i] += |g_i| d_i / 2,  count[i] += 1,
// g_i the gradient of the mean, d_i the distance from the camera. A product that is not finite is
// left out. max, sum and count may each be null.
void AccumulateDensity(std::int64_t size, const float* dl_dmeans, const float* distances,
                       const std::uint8_t* visible, float* max, float* sum, std::int32_t* count);

}  // namespace gsut
