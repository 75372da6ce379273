// Exact mean distance from each point to its nearest neighbours, by a k-d tree.
#pragma once

#include <cstdint>
#include <vector>

namespace gsut {

// Neighbours that the first scale of a Gaussian is taken from (3DGS).
inline constexpr int kSeedNeighbors = 3;

// For each of `count` points (count, 3): the mean distance to the three nearest other points, or to
// all others where there are fewer; 0 for a single point. Duplicates of a point are other points at
// distance 0. O(count log count); parallel, the same bits on any number of threads. Exact to
// rounding in double. The points must be finite.
std::vector<double> MeanNeighborDistances(const double* points, std::int64_t count);

}  // namespace gsut
