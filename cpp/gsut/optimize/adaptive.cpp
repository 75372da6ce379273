// Adaptive density control.
#include "gsut/optimize/adaptive.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/base/rng.h"
#include "gsut/gaussians/activations.h"

namespace gsut {
namespace {

constexpr std::int64_t kChunkRows = 1024;
// Scales of the two halves of a split are the parent's divided by this (3DGS).
constexpr double kSplitShrink = 1.6;

bool Grows(AdaptiveAction action) {
  return action == AdaptiveAction::kClone || action == AdaptiveAction::kSplit;
}

// The mean gradient of a Gaussian's place over the views that saw it: where it is large, the scene
// pulls a Gaussian to several sides, and one is not enough.
double Proxy(const float* sums, const std::int32_t* counts, std::int64_t row) {
  return counts[row] > 0 ? static_cast<double>(sums[row]) / counts[row] : 0.0;
}

// Takes growth away from the rows with the smallest proxies until at most `allowed` grow.
void LimitGrowth(const float* sums, const std::int32_t* counts, std::int64_t allowed,
                 std::vector<AdaptiveAction>* actions) {
  std::vector<std::int64_t> growing;
  for (std::size_t row = 0; row < actions->size(); ++row) {
    if (Grows((*actions)[row])) growing.push_back(static_cast<std::int64_t>(row));
  }
  const auto keep = static_cast<std::size_t>(std::max<std::int64_t>(allowed, 0));
  if (growing.size() <= keep) return;
  std::stable_sort(growing.begin(), growing.end(), [&](std::int64_t a, std::int64_t b) {
    return Proxy(sums, counts, a) > Proxy(sums, counts, b);
  });
  for (std::size_t i = keep; i < growing.size(); ++i) {
    (*actions)[static_cast<std::size_t>(growing[i])] = AdaptiveAction::kKeep;
  }
}

// Moves row and copy to places drawn from the row's Gaussian and shrinks both.
void Split(const GaussiansView<float>& params, std::int64_t row, std::int64_t copy,
           std::uint64_t parent, const Rng& rng) {
  const float* q = params.quats + 4 * row;
  const double quat[4] = {q[0], q[1], q[2], q[3]};
  double rotation[9], deviations[3];
  RotationFromQuaternion(quat, rotation);
  for (int axis = 0; axis < 3; ++axis) {
    const double log_scale = params.log_scales[3 * row + axis];
    deviations[axis] = ScaleFromLog(log_scale);
    const auto shrunk = static_cast<float>(log_scale - std::log(kSplitShrink));
    params.log_scales[3 * row + axis] = params.log_scales[3 * copy + axis] = shrunk;
  }
  // Six normal numbers, a function of the parent's row alone: threads do not matter.
  const auto a = rng.Normals(3 * parent), b = rng.Normals(3 * parent + 1),
             c = rng.Normals(3 * parent + 2);
  const double normals[2][3] = {{a[0], a[1], b[0]}, {b[1], c[0], c[1]}};
  // mean + R S n: a sample of the parent's own density.
  for (int half = 0; half < 2; ++half) {
    float* mean = params.means + 3 * (half == 0 ? row : copy);
    for (int i = 0; i < 3; ++i) {
      double shift = 0.0;
      for (int axis = 0; axis < 3; ++axis) {
        shift += rotation[3 * i + axis] * deviations[axis] * normals[half][axis];
      }
      mean[i] = static_cast<float>(mean[i] + shift);
    }
  }
}

}  // namespace

AdaptivePlan PlanAdaptive(const GaussiansView<float>& params, std::int64_t size,
                          const float* gradient_sums, const std::int32_t* counts,
                          const AdaptiveOptions& options) {
  AdaptivePlan plan;
  plan.actions.assign(static_cast<std::size_t>(size), AdaptiveAction::kKeep);
  ParallelFor(size, kChunkRows, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t row = begin; row < end; ++row) {
      const float* s = params.log_scales + 3 * row;
      const double scale = ScaleFromLog(static_cast<double>(std::max(s[0], std::max(s[1], s[2]))));
      const double opacity = Sigmoid(static_cast<double>(params.opacity_logits[row]));
      AdaptiveAction& action = plan.actions[static_cast<std::size_t>(row)];
      // What is no number, transparent or huge goes; what is pulled about is doubled: small ones
      // are copied, large ones split.
      if (!RowIsFinite(params, row) || opacity < options.prune_opacity ||
          scale > options.max_scale) {
        action = AdaptiveAction::kPrune;
      } else if (Proxy(gradient_sums, counts, row) > options.gradient_threshold) {
        action = scale <= options.clone_scale ? AdaptiveAction::kClone : AdaptiveAction::kSplit;
      }
    }
  });
  // Pruned rows make room, so the limit counts what remains.
  plan.pruned = std::count(plan.actions.begin(), plan.actions.end(), AdaptiveAction::kPrune);
  if (options.max_gaussians > 0) {
    LimitGrowth(gradient_sums, counts, options.max_gaussians - (size - plan.pruned), &plan.actions);
  }
  plan.cloned = std::count(plan.actions.begin(), plan.actions.end(), AdaptiveAction::kClone);
  plan.split = std::count(plan.actions.begin(), plan.actions.end(), AdaptiveAction::kSplit);
  return plan;
}

std::int64_t ApplyAdaptive(const TrainingState& state, const AdaptivePlan& plan, std::uint64_t seed,
                           std::int64_t step) {
  CheckState(state);
  if (static_cast<std::int64_t>(plan.actions.size()) != state.size) {
    throw InputError("the densification plan is for " + std::to_string(plan.actions.size()) +
                     " Gaussians, there are " + std::to_string(state.size));
  }
  CheckCapacity(state, plan.SizeAfter(), "adaptive densification");
  // First compact in place, in order, so that no row is overwritten before it is moved; then write
  // copies behind the rows that were kept.
  std::vector<std::int64_t> parents;  // row before pruning
  std::vector<std::int64_t> rows;     // and after
  std::int64_t kept = 0;
  for (std::int64_t row = 0; row < state.size; ++row) {
    const AdaptiveAction action = plan.actions[static_cast<std::size_t>(row)];
    if (action == AdaptiveAction::kPrune) continue;
    if (kept != row) CopyRow(state, row, kept);
    if (Grows(action)) {
      parents.push_back(row);
      rows.push_back(kept);
    }
    ++kept;
  }
  const Rng rng(seed, RandomStream(RandomUse::kAdaptiveSplit, step));
  ParallelFor(static_cast<std::int64_t>(parents.size()), kChunkRows,
              [&](std::int64_t begin, std::int64_t end) {
                for (std::int64_t i = begin; i < end; ++i) {
                  const std::int64_t parent = parents[static_cast<std::size_t>(i)];
                  const std::int64_t row = rows[static_cast<std::size_t>(i)];
                  CopyParams(state.params, row, kept + i);
                  ZeroMoments(state, kept + i);
                  if (plan.actions[static_cast<std::size_t>(parent)] == AdaptiveAction::kSplit) {
                    Split(state.params, row, kept + i, static_cast<std::uint64_t>(parent), rng);
                    ZeroMoments(state, row);
                  }
                }
              });
  return plan.SizeAfter();
}

// 3DGS lowers all opacities at times: Gaussians that photographs need come back, floaters do not.
void ResetOpacities(const TrainingState& state, double max_opacity) {
  CheckState(state);
  if (!(max_opacity > 0.0 && max_opacity < 1.0)) {
    throw InputError("max_opacity is " + std::to_string(max_opacity) +
                     "; give a value between 0 and 1, both excluded");
  }
  const auto limit = static_cast<float>(Logit(max_opacity));
  for (std::int64_t row = 0; row < state.size; ++row) {
    float& logit = state.params.opacity_logits[row];
    if (logit > limit) logit = limit;
    state.moment1.opacity_logits[row] = state.moment2.opacity_logits[row] = 0.0f;
  }
}

// gradient x distance is the gradient in pixels but for the focal length: near and far alike.
void AccumulateDensity(std::int64_t size, const float* dl_dmeans, const float* distances,
                       const std::uint8_t* visible, float* max, float* sum, std::int32_t* count) {
  ParallelFor(size, kChunkRows, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t row = begin; row < end; ++row) {
      if (visible != nullptr && visible[row] == 0) continue;
      const double x = dl_dmeans[3 * row], y = dl_dmeans[3 * row + 1], z = dl_dmeans[3 * row + 2];
      const auto product = static_cast<float>(std::sqrt(x * x + y * y + z * z) * distances[row]);
      // Also false for NaN.
      if (!(product <= std::numeric_limits<float>::max())) continue;
      if (max != nullptr) max[row] = std::max(max[row], product);
      if (sum != nullptr) sum[row] += 0.5f * product;
      if (count != nullptr) ++count[row];
    }
  });
}

}  // namespace gsut
