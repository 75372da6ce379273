// A palette: few rows of numbers that stand for many, such as the harmonics of a million Gaussians.
#pragma once

#include <cstdint>
#include <vector>

namespace gsut {

struct PaletteOptions {
  std::int64_t entries = 1024;  // at most; no more than there are rows
  int rounds = 10;              // of Lloyd's algorithm on each of the two levels
};

struct Palette {
  std::vector<float> entries;         // (M, columns)
  std::vector<std::uint32_t> labels;  // (rows): each row's entry
};

// k-means on two levels: rows fall into about sqrt(entries) cells, and each cell is given entries
// in proportion to its rows. A row is compared with 2 sqrt(entries) entries a round instead of all
// of them. Squared differences; each entry is the mean of its rows. Starts from rows at equal
// distances in the given order, so neighbours should stand together. The same bits on any number of
// threads; instruction sets round differently. Memory: twice the rows. Throws InputError unless
// there are rows, columns, entries and rounds, or if a value is not finite.
// Source of the idea: Jegou, Douze, Schmid, "Product Quantization for Nearest Neighbor Search",
// 2011 (its coarse quantiser).
Palette MakePalette(const float* rows, std::int64_t count, int columns,
                    const PaletteOptions& options);

}  // namespace gsut
