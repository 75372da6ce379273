// Bottom-up merging inside one block: which pairs, in which order, and the result.
#pragma once

#include <cstdint>
#include <vector>

#include "gsut/gaussians/gaussians.h"
#include "gsut/optimize/compact.h"

namespace gsut {

struct BlockRows {
  const std::uint32_t* rows;
  std::int64_t count;
};

// Cluster `other` goes into cluster `into` (places within the block) at this cost.
struct MergeStep {
  std::uint32_t into, other;
  double cost;
};

// The merges from all rows of the block down to `kept` clusters, always the cheapest pair among
// near neighbours (exactly so but for neighbours whose partner has just merged with another).
std::vector<MergeStep> PlanMerges(const GaussiansView<const float>& gaussians, BlockRows block,
                                  const float* weights, std::int64_t kept,
                                  const MergeOptions& options);

// Makes the merges and writes what is left to the rows `first` .. of `out`, by smallest member.
void CarryOutMerges(const GaussiansView<const float>& gaussians, BlockRows block,
                    const float* weights, const std::vector<MergeStep>& steps,
                    const GaussiansView<float>& out, std::int64_t first);

}  // namespace gsut
