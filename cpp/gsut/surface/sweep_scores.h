// How well windows of a photograph agree with neighbouring photographs at tried distances.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace gsut {

// A photograph, and the distances that are tried. A projection is known at the centres of cells.
struct SweepGrid {
  int width = 0;
  int height = 0;
  int depths = 0;
  int cell = 0;  // side, pixels

  int columns() const { return (width + cell - 1) / cell; }
  int rows() const { return (height + cell - 1) / cell; }
  std::int64_t pixels() const { return std::int64_t{width} * height; }
};

// A neighbouring photograph. `nearness`, `shown` and `trust` are all given or all null.
struct SweepNeighbour {
  int width = 0;
  int height = 0;
  const float* grey = nullptr;    // (height, width), 0 where masked
  const float* places = nullptr;  // (depths, rows, columns, 2): where it shows the cells' centres;
                                  // (0.5, 0.5) is the first pixel's centre, NaN where unseen
  const float* nearness = nullptr;  // (depths, rows, columns): inverse distances from it
  const float* shown = nullptr;     // (height, width): inverse distances that it shows; 0: unknown
  const float* trust = nullptr;     // (height, width): in [0, 1], of `shown`
};

struct SweepOptions {
  float contrast = 0.0F;   // standard deviation of noise in a window, grey values in [0, 1]
  float step = 0.0F;       // between inverse distances that are tried
  float agreement = 0.0F;  // of what a neighbour shows at the same distance, or not
  float near_step = 0.0F;  // cost of a difference of one distance between neighbouring pixels
  float far_step = 0.0F;   // cost of any larger difference
  float edge = 0.0F;       // difference of grey values that halves `far_step`
};

// scores (height, width, depths): the mean of the three best correlations of 5 x 5 windows, in
// [-1, 1]; with what neighbours show, plus `agreement` times the trust in each that shows a surface
// there, minus it for each that sees through. grey (height, width) is 0 where masked.
void ScoreWindows(const SweepGrid& grid, const float* grey,
                  std::span<const SweepNeighbour> neighbours, const SweepOptions& options,
                  float* scores);

}  // namespace gsut
