// Densification by MCMC: dead Gaussians move onto living ones, new ones are added the same way, and
// noise lets the nearly transparent ones explore.
//
// Source: Kheradmand et al., "3D Gaussian splatting as Markov chain Monte Carlo", NeurIPS 2024.
#pragma once

#include <cstdint>

#include "gsut/optimize/training_state.h"

namespace gsut {

struct McmcOptions {
  double dead_opacity = 0.005;  // at or below: dead (paper)
  std::uint64_t seed = 0;
  std::int64_t step = 0;  // the training step, part of the random stream
};

struct McmcCounts {
  std::int64_t size = 0;       // rows alive afterwards
  std::int64_t relocated = 0;  // dead rows that were given a new life
  std::int64_t added = 0;      // rows appended
};

// The most Gaussians that one may become at once (paper: 51).
inline constexpr int kMcmcMaxCopies = 51;

// Relocates every dead row and appends rows up to target_size (no row is ever taken away). A row is
// dead if its opacity says so (options) or if one of its parameters is not finite. Sources are
// living rows, drawn in proportion to weights (state.size floats; what is not finite or negative
// counts as 0; if all are 0, all living rows are equal) by stratified sampling, each at most
// kMcmcMaxCopies - 1 times; where that limits, fewer rows are relocated or added, and with no
// living row none.
//
// Where the paper puts the n Gaussians that replace one at the same place (its equation 9), they
// are spread over the parent's volume, as a finer covering of it: scales times n^(-1/3); centres
// drawn from the parent times sqrt(1 - n^(-2/3)) and shifted so that their mean is the parent's
// centre. The mixture then has the parent's mean exactly and its covariance in expectation. The
// opacity becomes 1 - (1 - o)^(n^(-1/3)), which keeps the optical thickness: the projected area
// shrinks by n^(-2/3). It is kept in [dead_opacity, 1 - 1e-6] so that a copy does not start dead.
// Moments of sources and copies become 0. The same bits on any number of threads. Throws InputError
// if target_size exceeds the capacity.
McmcCounts McmcDensify(const TrainingState& state, std::int64_t target_size, const float* weights,
                       const McmcOptions& options);

// Adds Sigma e sigmoid(-100 (opacity - 0.005)) noise_scale learning_rate, e standard normal, to
// each of the first `size` means (paper, equation 8; noise_scale 5e5, learning_rate that of the
// means). Rows whose noise would stay below 1e-4 of their own largest standard deviation are
// skipped, which leaves out opacities above about 0.1; so are rows whose numbers are not finite.
void McmcNoise(const GaussiansView<float>& params, std::int64_t size, double learning_rate,
               double noise_scale, std::uint64_t seed, std::int64_t step);

// Adds the gradient of opacity_weight mean(opacity) + scale_weight mean(scale) over the first
// `size` rows to the gradients of logits and log-scales (paper: both weights 0.01).
void AddMcmcRegularizer(const GaussiansView<const float>& params, std::int64_t size,
                        double opacity_weight, double scale_weight, float* dl_dopacity_logits,
                        float* dl_dlog_scales);

}  // namespace gsut
