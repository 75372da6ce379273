// MCMC relocation and growth.
#include "gsut/optimize/mcmc.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/base/rng.h"
#include "gsut/gaussians/activations.h"

namespace gsut {
namespace {

constexpr std::int64_t kChunkRows = 1024;
// Largest opacity that relocation computes with: its logit, 13.8, is far from where float ends.
constexpr double kMaxOpacity = 1.0 - 1e-6;

// Relocation (Kheradmand et al., "3D Gaussian splatting as Markov chain Monte Carlo", 2024) moves
// dead Gaussians to where living ones are, such that the picture changes as little as possible. The
// paper puts n copies at one place, and solves for an opacity. Here a Gaussian becomes n smaller
// ones spread over its volume:
//   scales    s' = s n^(-1/3)                n volumes s'^3 are the parent's;
//   opacity   1 - o' = (1 - o)^(n^(-1/3))    optical thickness -log(1 - o) is density times length,
//             and a copy's length is n^(-1/3) of the parent's;
//   places    offsets with variance (1 - n^(-2/3)) s^2, so that offset and copy together have the
//             parent's variance s^2.

std::vector<std::uint8_t> FindAlive(const TrainingState& state, const McmcOptions& options) {
  std::vector<std::uint8_t> alive(static_cast<std::size_t>(state.size));
  ParallelFor(state.size, kChunkRows, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t row = begin; row < end; ++row) {
      const double opacity = Sigmoid(static_cast<double>(state.params.opacity_logits[row]));
      alive[static_cast<std::size_t>(row)] =
          RowIsFinite(state.params, row) && opacity > options.dead_opacity;
    }
  });
  return alive;
}

// Draws `wanted` sources by stratified sampling (one uniform number in each of `wanted` equal parts
// of the weights' sum) and adds them to copies[row], never beyond kMcmcMaxCopies - 1. What the
// limit cuts off is drawn again among the others. Returns how many were placed.
std::int64_t DrawSources(std::int64_t wanted, std::vector<double>* weights, const Rng& rng,
                         std::vector<int>* copies) {
  // One number in each of `draws` equal parts: every row gets its expected number of copies to
  // within one, which plain sampling would miss by its square root.
  const std::size_t rows = weights->size();
  std::int64_t placed = 0;
  std::uint64_t counter = 0;
  while (placed < wanted) {
    double total = 0.0;
    std::size_t last = 0;  // the last row with a weight: rounding must not run past it
    for (std::size_t i = 0; i < rows; ++i) {
      total += (*weights)[i];
      if ((*weights)[i] > 0.0) last = i;
    }
    if (!(total > 0.0)) break;
    const std::int64_t draws = wanted - placed;
    double cumulative = (*weights)[0];
    std::size_t row = 0;
    for (std::int64_t draw = 0; draw < draws; ++draw) {
      const double at =
          (static_cast<double>(draw) + rng.Uniform(counter++)) * total / static_cast<double>(draws);
      while (cumulative <= at && row < last) cumulative += (*weights)[++row];
      if ((*copies)[row] + 1 < kMcmcMaxCopies) {
        ++(*copies)[row];
        ++placed;
      }
    }
    // Full rows take no part in the next round.
    for (std::size_t i = 0; i < rows; ++i) {
      if ((*copies)[i] + 1 >= kMcmcMaxCopies) (*weights)[i] = 0.0;
    }
  }
  return placed;
}

// Offsets of n copies in units of the parent's standard deviations, mean 0.
void DrawOffsets(int n, const Rng& rng, std::int64_t source, double* offsets) {
  // Removing the mean of n draws takes 1/n of their variance; put it back.
  const double spread = std::sqrt(1.0 - std::pow(n, -2.0 / 3.0)) * std::sqrt(n / (n - 1.0));
  double mean[3] = {0, 0, 0};
  for (int i = 0; i < n; ++i) {
    const std::uint64_t counter =
        (static_cast<std::uint64_t>(source) * kMcmcMaxCopies + static_cast<std::uint64_t>(i)) * 2;
    const auto first = rng.Normals(counter), second = rng.Normals(counter + 1);
    const double normal[3] = {first[0], first[1], second[0]};
    for (int axis = 0; axis < 3; ++axis) {
      offsets[3 * i + axis] = spread * normal[axis];
      mean[axis] += offsets[3 * i + axis] / n;
    }
  }
  for (int i = 0; i < n; ++i) {
    for (int axis = 0; axis < 3; ++axis) offsets[3 * i + axis] -= mean[axis];
  }
}

// Replaces row `source` by itself and the rows destinations[0 .. n-2].
void Replace(const TrainingState& state, std::int64_t source, int n,
             const std::int64_t* destinations, const Rng& place, const McmcOptions& options) {
  const GaussiansView<float>& params = state.params;
  const double opacity =
      std::min(Sigmoid(static_cast<double>(params.opacity_logits[source])), kMaxOpacity);
  const double factor = std::pow(n, -1.0 / 3.0);
  const double copy_opacity = std::min(
      std::max(-std::expm1(std::log1p(-opacity) * factor), options.dead_opacity), kMaxOpacity);
  double deviations[3];
  for (int axis = 0; axis < 3; ++axis) {
    float& log_scale = params.log_scales[3 * source + axis];
    deviations[axis] = ScaleFromLog(static_cast<double>(log_scale));
    log_scale = static_cast<float>(log_scale + std::log(factor));
  }
  // Rounded up, so that a copy at the limit is not found dead at the next call.
  float logit = static_cast<float>(Logit(copy_opacity));
  if (Sigmoid(static_cast<double>(logit)) <= options.dead_opacity) {
    logit = std::nextafter(logit, 1e30f);
  }
  params.opacity_logits[source] = logit;
  ZeroMoments(state, source);
  for (int i = 0; i + 1 < n; ++i) {
    CopyParams(params, source, destinations[i]);
    ZeroMoments(state, destinations[i]);
  }
  // Offsets are along the parent's axes: R S offset.
  double offsets[3 * kMcmcMaxCopies];
  DrawOffsets(n, place, source, offsets);
  double rotation[9];
  const float* q = params.quats + 4 * source;
  const double quat[4] = {q[0], q[1], q[2], q[3]};
  RotationFromQuaternion(quat, rotation);
  for (int i = 0; i < n; ++i) {
    float* mean = params.means + 3 * (i == 0 ? source : destinations[i - 1]);
    for (int row = 0; row < 3; ++row) {
      double shift = 0.0;
      for (int axis = 0; axis < 3; ++axis) {
        shift += rotation[3 * row + axis] * deviations[axis] * offsets[3 * i + axis];
      }
      mean[row] = static_cast<float>(mean[row] + shift);
    }
  }
}

}  // namespace

McmcCounts McmcDensify(const TrainingState& state, std::int64_t target_size, const float* weights,
                       const McmcOptions& options) {
  CheckState(state);
  CheckCapacity(state, target_size, "growing to " + std::to_string(target_size) + " Gaussians");
  if (!(options.dead_opacity > 0.0 && options.dead_opacity < 1.0)) {
    throw InputError("dead_opacity is " + std::to_string(options.dead_opacity) +
                     "; give a value between 0 and 1, both excluded");
  }
  const std::vector<std::uint8_t> alive = FindAlive(state, options);
  const std::size_t rows = alive.size();
  std::vector<std::int64_t> destinations;
  std::vector<double> chances(rows, 0.0);
  double total = 0.0;
  for (std::size_t row = 0; row < rows; ++row) {
    if (!alive[row]) {
      destinations.push_back(static_cast<std::int64_t>(row));
    } else if (weights[row] > 0.0f && weights[row] <= std::numeric_limits<float>::max()) {
      chances[row] = weights[row];
      total += chances[row];
    }
  }
  const auto dead = static_cast<std::int64_t>(destinations.size());
  // No weight at all, as before the first gradient: all that live have the same chance.
  if (total == 0.0) chances.assign(alive.begin(), alive.end());
  for (std::int64_t row = state.size; row < target_size; ++row) destinations.push_back(row);
  if (rows == 0 || destinations.empty()) return {state.size, 0, 0};

  std::vector<int> copies(rows, 0);
  const std::int64_t placed =
      DrawSources(static_cast<std::int64_t>(destinations.size()), &chances,
                  Rng(options.seed, RandomStream(RandomUse::kMcmcDraw, options.step)), &copies);
  // Each source owns a run of destinations, so sources are independent of each other.
  std::vector<std::int64_t> sources, first_destination;
  std::int64_t used = 0;
  for (std::size_t row = 0; row < rows; ++row) {
    if (copies[row] == 0) continue;
    sources.push_back(static_cast<std::int64_t>(row));
    first_destination.push_back(used);
    used += copies[row];
  }
  const Rng place(options.seed, RandomStream(RandomUse::kMcmcPlace, options.step));
  constexpr std::int64_t kChunkSources = 64;
  ParallelFor(static_cast<std::int64_t>(sources.size()), kChunkSources,
              [&](std::int64_t begin, std::int64_t end) {
                for (std::int64_t i = begin; i < end; ++i) {
                  const auto at = static_cast<std::size_t>(i);
                  const int n = copies[static_cast<std::size_t>(sources[at])] + 1;
                  Replace(state, sources[at], n, destinations.data() + first_destination[at], place,
                          options);
                }
              });
  const std::int64_t relocated = std::min(placed, dead);
  return {state.size + placed - relocated, relocated, placed - relocated};
}

}  // namespace gsut
