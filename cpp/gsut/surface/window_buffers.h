// What windows of photographs are compared by: packed grey values, ways into a neighbour, scores.
#pragma once

#include <cstdint>
#include <vector>

#include "gsut/surface/depth_view.h"

namespace gsut {

constexpr int kWindowHalf = 3;    // of the windows: 7 x 7 pixels
constexpr int kWindowTries = 5;   // distances
constexpr int kWindowLanes = 16;  // pixels that buffers of rows are padded by

// A photograph with a border, so that windows need no tests: each number holds a pixel and the one
// to its right.
struct PackedGrey {
  int width = 0, height = 0;
  std::vector<std::int32_t> pairs;
};

// The windows of some pixels of a row in one neighbour: place of the middle, steps to the right and
// down, each at the first distance and by tried distance.
struct WindowPaths {
  alignas(64) float at[6][kPointBatch], by[6][kPointBatch];
};

struct WindowScores {
  alignas(64) float of[kWindowTries][kPointBatch];
};

}  // namespace gsut
