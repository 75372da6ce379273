// Nearest neighbours between two sets of unit descriptors, both ways at once.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace gsut {

inline constexpr int kDescriptorLength = 128;  // of SIFT

struct MatchOptions {
  // Largest ratio of the distance to the nearest over that to the second nearest (Lowe's test),
  // asked of both sides.
  double max_ratio = 0.8;
  double max_distance = 0.7;  // between unit vectors
};

struct FeatureMatch {
  int first = 0, second = 0;
  float distance = 0.0F;
  float ratio = 0.0F;  // of the distances, nearest to second nearest: the larger one of both sides
};

// Features that are each other's nearest and pass both tests, most distinct (smallest ratio)
// first. Exact: all pairs are compared, in float; on every instruction set the same up to rounding.
// Args: first (num_first, 128), second (num_second, 128): row-major, of unit length.
// Throws InputError for a negative number.
std::vector<FeatureMatch> MatchDescriptors(const float* first, int num_first, const float* second,
                                           int num_second, const MatchOptions& options);

}  // namespace gsut
