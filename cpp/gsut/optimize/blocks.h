// Splits a set of points into balanced blocks by repeated halving at the median.
#pragma once

#include <cstdint>
#include <vector>

namespace gsut {

enum class BlockAxis {
  kCycle,      // x, y, z in turn (GHAP as published)
  kPrincipal,  // the direction of largest spread: blocks turn with the scene
};

struct Blocks {
  std::vector<std::uint32_t> order;  // rows, block by block
  std::vector<std::int64_t> begin;   // (blocks + 1), into order

  std::int64_t size() const { return static_cast<std::int64_t>(begin.size()) - 1; }
};

// 2^depth blocks whose sizes differ by at most one. points: (count, 3), finite; rows: which of them
// (increasing). Fewer levels where there are fewer rows than blocks. The same on any number of
// threads.
Blocks SplitIntoBlocks(const float* points, const std::vector<std::uint32_t>& rows, int depth,
                       BlockAxis axis);

}  // namespace gsut
