// How well windows of a photograph correlate with a neighbouring photograph at tried distances.
#pragma once

#include <cstdint>
#include <vector>

#include "gsut/surface/depth_view.h"

namespace gsut {

inline constexpr int kWindowHalf = 3;    // of the windows: 7 x 7 pixels
inline constexpr int kWindowTries = 5;   // distances
inline constexpr int kWindowLanes = 16;  // pixels that buffers of rows are padded by

// A photograph that windows look into: a pixel and the one to its right in one number, so that a
// place takes two gathers in place of four. Of each 15 bits of grey value, and a bit that says
// whether it may be looked at. The last column is its own neighbour; windows end before it.
struct PackedGrey {
  // grey (height, width) in [0, 1]; NaN: masked.
  PackedGrey(const float* grey, int width, int height);

  int width, height;
  std::vector<std::int32_t> pairs;
};

// The photograph whose windows are compared, with a border of NaN, in which windows fail.
class PaddedGrey {
 public:
  PaddedGrey(const float* grey, int width, int height);

  const float* At(int x, int y) const { return &values_[Index(x, y)]; }
  std::int64_t stride() const { return stride_; }
  // Whether the window around a pixel has any texture; false at borders.
  bool IsTextured(int x, int y) const;

 private:
  std::size_t Index(int x, int y) const {
    return static_cast<std::size_t>((y + kWindowHalf) * stride_ + kWindowHalf + x);
  }
  // Rows end with room for the vectors of the last pixels.
  std::int64_t stride_;
  std::vector<float> values_;
};

// The windows of some pixels of a row in one neighbour: column and row of the middle, of a step to
// the right, and of one down. NaN: nowhere.
struct WindowPaths {
  enum { kU, kV, kRightU, kRightV, kDownU, kDownV, kNumbers };
  alignas(64) float at[kNumbers][kPointBatch];  // at the present distance
  alignas(64) float by[kNumbers][kPointBatch];  // what a step to the next distance adds
};

// Correlation of each pixel at each distance, the present one in the middle.
struct WindowScores {
  alignas(64) float of[kWindowTries][kPointBatch];
};

// Correlations of `count` pixels, a multiple of kWindowLanes, of row y from column x on, with one
// neighbour; NaN where a window leaves a photograph or meets a masked pixel.
void CorrelateWindows(const PaddedGrey& own, int x, int y, int count, const PackedGrey& other,
                      const WindowPaths& paths, WindowScores* scores);

}  // namespace gsut
