// Tracks: features of different images that are the same point, joined over verified matches.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "gsut/geometry/pose.h"

namespace gsut {

// Matches of two images that agree with one relative pose.
struct VerifiedPair {
  int first = 0, second = 0;                // images, first < second
  std::vector<std::array<int, 2>> matches;  // (feature of first, feature of second)
  Pose second_from_first;                   // |translation| = 1
  int num_rotation_inliers = 0;             // see RelativePose
  double parallax = 0.0;                    // radians; see RelativePose
};

struct TrackElement {
  int image = 0;
  int feature = 0;
};

// Two features that are the same point.
struct TrackJoin {
  TrackElement first, second;
};

// Joins features in the order given. A join that would put two features of one image into one track
// is left out. Elements are ordered by image; tracks have at least two.
// Args: num_features: of each image. Throws InputError for an index out of range.
std::vector<std::vector<TrackElement>> JoinTracks(std::span<const int> num_features,
                                                  std::span<const TrackJoin> joins);

// Joins matches, pairs with most matches first, as JoinTracks does.
std::vector<std::vector<TrackElement>> BuildTracks(std::span<const int> num_features,
                                                   std::span<const VerifiedPair> pairs);

}  // namespace gsut
