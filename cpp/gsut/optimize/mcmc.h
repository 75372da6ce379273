// Densification by MCMC: dead Gaussians move onto living ones, new ones are added the same way, and
// noise lets the nearly transparent ones explore.
//
// Source: Kheradmand et al., "3D Gaussian splatting as Markov chain Monte Carlo", NeurIPS 2024.
#pragma once

#include <cstdint>

#include "gsut/optimize/training_state.h"

namespace gsut {

// How the n Gaussians that replace one are laid out.
enum class McmcPlacement {
  // The paper's equation 9: n copies at the same place, opacity 1 - (1 - o)^(1/n), scales shrunk so
  // that the integral of the opacity along a ray through the centre is kept.
  kSamePlace,
  // The n are spread over the parent's volume, as a finer covering of it: scales times n^(-1/3);
  // centres drawn from the parent times sqrt(1 - n^(-2/3)) and shifted so that their mean is the
  // parent's centre. The mixture then has the parent's mean exactly and its covariance in
  // expectation. Opacity 1 - (1 - o)^(n^-split_power).
  kSplit,
};

struct McmcOptions {
  double dead_opacity = 0.005;  // at or below: dead (paper)
  // World units; a Gaussian whose largest standard deviation is above is dead. Infinity: no limit.
  double max_scale = 1e30;
  McmcPlacement placement = McmcPlacement::kSplit;
  // kSplit: the exponent of the opacity rule above. 1/3 keeps the optical thickness (the projected
  // area shrinks by n^(-2/3), so n copies of thickness n^(-1/3) add up to the parent's); 1 is the
  // paper's rule, which makes the spread copies more transparent than their parent. Mean test
  // PSNR of two seeds in a stand-alone trainer, sponza_fisheye: 50 000 Gaussians after 500 steps
  // 1/3 30.87, 2/3 30.81, 1 30.73 dB; 100 000 after 1000 steps 1/3 32.98, 2/3 33.02 dB (0.1 is
  // noise).
  double split_power = 1.0 / 3.0;
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
// dead if its opacity or scale says so (options) or if one of its parameters is not finite. Sources
// are living rows, drawn in proportion to weights (state.size floats; what is not finite or
// negative counts as 0; if all are 0, all living rows are equal) by stratified sampling, each at
// most kMcmcMaxCopies - 1 times; where that limits, fewer rows are relocated or added, and with no
// living row none. Moments of sources and copies become 0. The new opacity is kept in
// [dead_opacity, 1 - 1e-6] so that a copy does not start dead.
// The same bits on any number of threads. Throws InputError if target_size exceeds the capacity.
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

// Opacity and scale factor of each of n copies at the same place (paper, equation 9), for tests.
// opacity in (0, 1), 1 <= n <= kMcmcMaxCopies.
void McmcSamePlace(double opacity, int n, double* copy_opacity, double* scale_factor);

}  // namespace gsut
