// Adam on float32 arrays in place: dense, or sparse (rows that nothing saw are left untouched).
#pragma once

#include <cstdint>
#include <vector>

#include "gsut/gaussians/harmonics_step.h"

namespace gsut {

// Defaults: 3DGS.
struct AdamOptions {
  double beta1 = 0.9;
  double beta2 = 0.999;
  double epsilon = 1e-15;
};

// One parameter array and its moments, all row-major with `columns` values a row.
struct AdamGroup {
  float* params = nullptr;
  const float* gradients = nullptr;
  float* moment1 = nullptr;
  float* moment2 = nullptr;
  int columns = 1;
  // Only the first `active_columns` of each row are stepped (harmonics not yet switched on).
  int active_columns = 1;
  // One value, or one for each active column.
  std::vector<double> learning_rates;
};

// One step of every group over the first `rows` rows:
//   m <- beta1 m + (1 - beta1) g,  v <- beta2 v + (1 - beta2) g^2,
//   p <- p - rate / (1 - beta1^step) m / (sqrt(v / (1 - beta2^step)) + epsilon).
// step counts from 1. visible: `rows` bytes, or null; a row whose byte is 0 keeps its parameters
// and moments. A gradient that is not finite spoils its own element only; densification finds it.
// No fused multiply-add is used, so the bits are the same on every instruction set and any number
// of threads.
// Throws InputError if step < 1, an option is out of range, or columns and rates disagree.
// Error against double arithmetic: below 4e-7 of the update that moment and gradient would give if
// they had the same sign, plus an ulp of the parameter.
//
// Source: Kingma and Ba, "Adam: a method for stochastic optimization", ICLR 2015, algorithm 1;
// sparse: Mallick et al., "Taming 3DGS", SIGGRAPH Asia 2024.
void AdamStep(const std::vector<AdamGroup>& groups, std::int64_t rows, std::int64_t step,
              const std::uint8_t* visible, const AdamOptions& options = {});

// The same step of one group of harmonics (its gradients are not read), for a backward pass to take
// row by row: to the same bits.
HarmonicsStep MakeHarmonicsStep(const AdamGroup& group, std::int64_t step,
                                const AdamOptions& options = {});

}  // namespace gsut
