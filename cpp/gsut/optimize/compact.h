// Fewer Gaussians for the same picture: reduction of the scene's mixture, block by block.
#pragma once

#include <cstdint>
#include <vector>

#include "gsut/gaussians/gaussians.h"

namespace gsut {

// Gaussians that own their arrays, in the shapes of GaussiansView.
struct GaussianArrays {
  GaussianArrays(std::int64_t size, int sh_coefficients);
  GaussiansView<float> View();

  std::int64_t size;
  int sh_coefficients;
  std::vector<float> means, quats, log_scales, opacity_logits, sh;
};

// Throws InputError unless the arrays are there and `rows` are among them.
void CheckRows(const GaussiansView<const float>& gaussians, const std::vector<std::uint32_t>& rows);

// GHAP as published: k-means in each block.
struct HerdOptions {
  double keep = 0.1;             // fraction of each block's Gaussians, (0, 1]
  int depth = 10;                // 2^depth blocks (paper; quality is flat from 6 to 16)
  int max_rounds = 100;          // paper
  double tolerance = 1e-5;       // the largest change of a mean or covariance entry (paper)
  double least_variance = 1e-6;  // world units squared (paper)
  std::uint64_t seed = 0;
};

// Gaussian reduction by k-means on mean and covariance, as published: blocks of a k-d tree (median,
// axes in turn), weights opacity / sum of the block's, random start, cost |dmean|^2 + |dcov|_F^2,
// new centres as weighted averages of means and covariances (no between-means term), opacity and
// harmonics copied from the member that is nearest to the centre. Centres that lose all members
// vanish. Each block keeps round(keep n), at least one. Fewer blocks where they would keep less
// than one.
// rows: the Gaussians to reduce (increasing, finite). The same bits on any number of threads.
// Source: Wang et al., "Gaussian Herding across Pens", 2025.
GaussianArrays HerdPaper(const GaussiansView<const float>& gaussians,
                         const std::vector<std::uint32_t>& rows, const HerdOptions& options);

struct MergeOptions {
  // Weight of the cost of shape beside the squared difference of colours, which is in [0, 1]: the
  // squared difference of the drawn fields over their squares, along the merged axes.
  double field_weight = 0.1;
  int neighbors = 10;     // candidates of each Gaussian
  int block_rows = 1024;  // most rows of a block
};

// Merges the pairs that cost least until `target` are left: in every block bottom up, then all
// blocks share one threshold of cost, so that reduction goes where the scene is simple. Merged
// means and covariances keep the mixture's first two moments (between-means term included), colours
// are averages by weight, opacity times shadow area is kept (up to the union of the members'
// opacities). What is not merged keeps its bits. Costs are relative: the result scales and turns
// with the scene.
// weights: (gaussians.size) how much each is seen, such as its blend weights summed over pixels;
// null: opacity times shadow area. rows as in HerdPaper; 1 <= target. Memory is linear.
GaussianArrays MergePairs(const GaussiansView<const float>& gaussians,
                          const std::vector<std::uint32_t>& rows, const float* weights,
                          std::int64_t target, const MergeOptions& options);

}  // namespace gsut
