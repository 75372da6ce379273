// Nearest neighbours between two sets of descriptors, both ways at once.
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
  double max_distance = 0.7;  // between descriptors of unit length
};

struct FeatureMatch {
  int first = 0, second = 0;
  float distance = 0.0F;
  float ratio = 0.0F;  // of the distances, nearest to second nearest: the larger one of both sides
};

// Features that are each other's nearest, by descriptors of unit length, and pass both tests, most
// distinct (smallest ratio) first. Exact: all pairs are compared; the same bits on every
// instruction set.
// Args: first (num_first, 128), second (num_second, 128): row-major, of any length.
// Throws InputError for a negative number.
std::vector<FeatureMatch> MatchDescriptors(const std::uint8_t* first, int num_first,
                                           const std::uint8_t* second, int num_second,
                                           const MatchOptions& options);

// Highway's name of the instruction set that MatchDescriptors uses now: "AVX3_DL" where there are
// dot products of bytes and no other set is forced (isa.h).
const char* MatchKernel();

}  // namespace gsut
