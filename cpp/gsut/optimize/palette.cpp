// k-means on two levels; the search for the nearest entry is a small matrix product.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/optimize/palette.cpp"
#include "gsut/base/hwy_targets.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "gsut/base/aligned_vector.h"
#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/optimize/palette.h"

#ifndef GSUT_OPTIMIZE_PALETTE_PACKED
#define GSUT_OPTIMIZE_PALETTE_PACKED
namespace gsut {

// k-means of N rows to K entries costs N K a round. In two levels it costs N sqrt(K): rows fall
// into sqrt(K) cells, and each cell's rows into the entries that it is given. Nearest in a cell is
// not quite nearest of all, which a palette of thousands of entries does not notice.
//
// |row - entry|^2 = |row|^2 - 2 (row . entry - |entry|^2 / 2): the nearest entry has the largest
// bracket, so the search is a matrix product with a start value.

constexpr int kBlock = 16;  // entries that are compared at once: a whole number of any vectors
constexpr int kRows = 4;    // rows that are compared at once

// Entries as the kernel reads them: blocks of kBlock, column by column, and half their squares.
struct PackedEntries {
  int columns = 0;
  std::int64_t blocks = 0;
  AlignedVector<float> values;       // (blocks, columns, kBlock)
  AlignedVector<float> half_square;  // (blocks, kBlock)
};

}  // namespace gsut
#endif

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

using Tag = hn::CappedTag<float, kBlock>;
using Vec = hn::Vec<Tag>;
constexpr int kWidth = static_cast<int>(hn::MaxLanes(Tag()));
constexpr int kVectors = kBlock / kWidth;

// The entry nearest to each of kRows rows: the largest a.b - b.b / 2; of equal ones the first.
void NearestOfRows(const float* const* rows, const PackedEntries& entries, std::uint32_t* labels) {
  const Tag d;
  Vec best[kRows], index[kRows];
  for (int r = 0; r < kRows; ++r) {
    best[r] = hn::Set(d, -std::numeric_limits<float>::infinity());
    index[r] = hn::Zero(d);
  }
  for (std::int64_t block = 0; block < entries.blocks; ++block) {
    const float* values = entries.values.data() + block * entries.columns * kBlock;
    Vec sums[kRows][kVectors];
    for (int v = 0; v < kVectors; ++v) {
      const Vec half = hn::Load(d, entries.half_square.data() + block * kBlock + v * kWidth);
      for (int r = 0; r < kRows; ++r) sums[r][v] = hn::Neg(half);
    }
    for (int column = 0; column < entries.columns; ++column) {
      Vec entry[kVectors];
      for (int v = 0; v < kVectors; ++v) {
        entry[v] = hn::Load(d, values + column * kBlock + v * kWidth);
      }
      for (int r = 0; r < kRows; ++r) {
        const Vec value = hn::Set(d, rows[r][column]);
        for (int v = 0; v < kVectors; ++v) sums[r][v] = hn::MulAdd(value, entry[v], sums[r][v]);
      }
    }
    for (int v = 0; v < kVectors; ++v) {
      const Vec at = hn::Set(d, static_cast<float>(block * kVectors + v));
      for (int r = 0; r < kRows; ++r) {
        const auto larger = hn::Gt(sums[r][v], best[r]);
        best[r] = hn::IfThenElse(larger, sums[r][v], best[r]);
        index[r] = hn::IfThenElse(larger, at, index[r]);
      }
    }
  }
  // Each lane has its own best: of equal ones the first entry wins, whatever the vector's width.
  for (int r = 0; r < kRows; ++r) {
    HWY_ALIGN float lane_best[kWidth], lane_index[kWidth];
    hn::Store(best[r], d, lane_best);
    hn::Store(index[r], d, lane_index);
    float most = -std::numeric_limits<float>::infinity();
    std::uint32_t label = 0;
    for (std::uint32_t lane = 0; lane < static_cast<std::uint32_t>(kWidth); ++lane) {
      const std::uint32_t at = static_cast<std::uint32_t>(lane_index[lane]) * kWidth + lane;
      if (lane_best[lane] > most || (lane_best[lane] == most && at < label)) {
        most = lane_best[lane];
        label = at;
      }
    }
    labels[r] = label;
  }
}

}  // namespace
}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
namespace {

HWY_EXPORT(NearestOfRows);

constexpr std::int64_t kChunkRows = 1024;
// Rows from which the cells are found: every cell then has dozens, and more of them would move its
// entry by less than the entries' distance.
constexpr std::int64_t kSample = 65536;

PackedEntries Pack(const float* entries, std::int64_t count, int columns) {
  PackedEntries packed;
  packed.columns = columns;
  packed.blocks = (count + kBlock - 1) / kBlock;
  packed.values.resize(static_cast<std::size_t>(packed.blocks * columns * kBlock));
  packed.half_square.resize(static_cast<std::size_t>(packed.blocks * kBlock));
  std::fill(packed.values.begin(), packed.values.end(), 0.0f);
  // What only fills a block is never the nearest.
  std::fill(packed.half_square.begin(), packed.half_square.end(),
            std::numeric_limits<float>::infinity());
  for (std::int64_t i = 0; i < count; ++i) {
    const std::int64_t block = i / kBlock, place = i % kBlock;
    double square = 0.0;
    for (int column = 0; column < columns; ++column) {
      const float value = entries[i * columns + column];
      square += double{value} * value;
      packed.values[static_cast<std::size_t>((block * columns + column) * kBlock + place)] = value;
    }
    packed.half_square[static_cast<std::size_t>(i)] = static_cast<float>(0.5 * square);
  }
  return packed;
}

void Nearest(const float* rows, std::int64_t count, const PackedEntries& entries,
             std::uint32_t* labels) {
  for (std::int64_t row = 0; row < count; row += kRows) {
    const float* four[kRows];
    std::uint32_t found[kRows];
    for (std::int64_t r = 0; r < kRows; ++r) {
      four[r] = rows + std::min(row + r, count - 1) * entries.columns;
    }
    HWY_DYNAMIC_DISPATCH(NearestOfRows)(four, entries, found);
    std::copy_n(found, std::min<std::int64_t>(kRows, count - row), labels + row);
  }
}

// Entries become the means of their rows; one without rows stays. Returns whether one has moved.
// Sums in double, in the order of rows.
bool MoveToMeans(const float* rows, std::int64_t count, int columns, const std::uint32_t* labels,
                 std::int64_t size, float* entries) {
  std::vector<double> sums(static_cast<std::size_t>(size * columns), 0.0);
  std::vector<std::int64_t> members(static_cast<std::size_t>(size), 0);
  for (std::int64_t row = 0; row < count; ++row) {
    ++members[labels[row]];
    double* sum = sums.data() + std::int64_t{labels[row]} * columns;
    for (int column = 0; column < columns; ++column) sum[column] += rows[row * columns + column];
  }
  bool moved = false;
  for (std::int64_t i = 0; i < size; ++i) {
    const std::int64_t number = members[static_cast<std::size_t>(i)];
    if (number == 0) continue;
    for (std::int64_t at = i * columns; at < (i + 1) * columns; ++at) {
      const auto mean =
          static_cast<float>(sums[static_cast<std::size_t>(at)] / static_cast<double>(number));
      moved = moved || mean != entries[at];
      entries[at] = mean;
    }
  }
  return moved;
}

// Lloyd's algorithm from rows at equal distances; assign(packed, labels) finds the nearest entries.
template <class Assign>
void Cluster(const float* rows, std::int64_t count, int columns, std::int64_t size, int rounds,
             const Assign& assign, float* entries, std::uint32_t* labels) {
  // Starts are evenly spaced rows: no random numbers, so the same rows give the same palette.
  for (std::int64_t i = 0; i < size; ++i) {
    std::copy_n(rows + ((2 * i + 1) * count / (2 * size)) * columns, columns,
                entries + i * columns);
  }
  assign(Pack(entries, size, columns), labels);
  for (int round = 0; round < rounds; ++round) {
    if (!MoveToMeans(rows, count, columns, labels, size, entries)) return;
    assign(Pack(entries, size, columns), labels);
  }
}

// Rows by cell, in order.
struct Cells {
  std::vector<std::int64_t> begin;  // (cells + 1), into `rows`
  std::vector<std::uint32_t> rows;
};

Cells FindCells(const float* rows, std::int64_t count, int columns, std::int64_t size, int rounds) {
  const std::int64_t stride = std::max<std::int64_t>(1, count / kSample);
  const std::int64_t drawn = (count + stride - 1) / stride;
  std::vector<float> sample(static_cast<std::size_t>(drawn * columns));
  for (std::int64_t i = 0; i < drawn; ++i) {
    std::copy_n(rows + i * stride * columns, columns, sample.data() + i * columns);
  }
  const auto assign_to = [columns](const float* data, std::int64_t number,
                                   const PackedEntries& packed, std::uint32_t* labels) {
    ParallelFor(number, kChunkRows, [&](std::int64_t begin, std::int64_t end) {
      Nearest(data + begin * columns, end - begin, packed, labels + begin);
    });
  };
  std::vector<float> centers(static_cast<std::size_t>(size * columns));
  std::vector<std::uint32_t> labels(static_cast<std::size_t>(count));
  Cluster(
      sample.data(), drawn, columns, size, rounds,
      [&](const PackedEntries& packed, std::uint32_t* to) {
        assign_to(sample.data(), drawn, packed, to);
      },
      centers.data(), labels.data());
  assign_to(rows, count, Pack(centers.data(), size, columns), labels.data());
  // A counting sort by label keeps rows in order within their cell.
  Cells cells;
  cells.begin.assign(static_cast<std::size_t>(size + 1), 0);
  for (const std::uint32_t label : labels) ++cells.begin[label + 1];
  for (std::size_t i = 1; i < cells.begin.size(); ++i) cells.begin[i] += cells.begin[i - 1];
  std::vector<std::int64_t> at(cells.begin.begin(), cells.begin.end() - 1);
  cells.rows.resize(static_cast<std::size_t>(count));
  for (std::int64_t row = 0; row < count; ++row) {
    const auto place = at[labels[static_cast<std::size_t>(row)]]++;
    cells.rows[static_cast<std::size_t>(place)] = static_cast<std::uint32_t>(row);
  }
  return cells;
}

// Entries of each cell, as offsets: in proportion to its rows, one at least where it has any, and
// together no more than `entries`.
// Rounding down keeps the sum within `entries`; the one that each cell has at least is paid for
// first.
std::vector<std::int64_t> ShareOut(const Cells& cells, std::int64_t count, std::int64_t entries) {
  const auto size = static_cast<std::int64_t>(cells.begin.size()) - 1;
  std::vector<std::int64_t> offsets(cells.begin.size(), 0);
  for (std::int64_t cell = 0; cell < size; ++cell) {
    const auto i = static_cast<std::size_t>(cell);
    const std::int64_t members = cells.begin[i + 1] - cells.begin[i];
    const double share = static_cast<double>(members) * static_cast<double>(entries - size) /
                         static_cast<double>(count);
    offsets[i + 1] = offsets[i] + std::min(members, 1 + static_cast<std::int64_t>(share));
  }
  return offsets;
}

}  // namespace

Palette MakePalette(const float* rows, std::int64_t count, int columns,
                    const PaletteOptions& options) {
  if (count < 1 || columns < 1 || options.entries < 1 || options.rounds < 1) {
    throw InputError("a palette needs rows, columns, entries and rounds, found " +
                     std::to_string(count) + ", " + std::to_string(columns) + ", " +
                     std::to_string(options.entries) + " and " + std::to_string(options.rounds));
  }
  CheckGiven(rows, "rows");
  if (!std::all_of(rows, rows + count * columns, [](float x) { return std::isfinite(x); })) {
    throw InputError("a palette needs finite values");
  }
  // The number of cells equals that of a cell's entries, so both levels cost the same.
  const std::int64_t most = std::min(options.entries, count);
  const auto size = static_cast<std::int64_t>(std::sqrt(static_cast<double>(most)));
  const Cells cells = FindCells(rows, count, columns, size, options.rounds);
  const std::vector<std::int64_t> offsets = ShareOut(cells, count, most);
  Palette palette;
  palette.entries.resize(static_cast<std::size_t>(offsets.back() * columns));
  palette.labels.resize(static_cast<std::size_t>(count));
  ParallelFor(size, 1, [&](std::int64_t first, std::int64_t last) {
    for (std::int64_t cell = first; cell < last; ++cell) {
      const auto i = static_cast<std::size_t>(cell);
      const std::int64_t begin = cells.begin[i], members = cells.begin[i + 1] - begin;
      if (members == 0) continue;
      std::vector<float> own(static_cast<std::size_t>(members * columns));
      std::vector<std::uint32_t> labels(static_cast<std::size_t>(members));
      for (std::int64_t m = 0; m < members; ++m) {
        const std::int64_t row = cells.rows[static_cast<std::size_t>(begin + m)];
        std::copy_n(rows + row * columns, columns, own.data() + m * columns);
      }
      Cluster(
          own.data(), members, columns, offsets[i + 1] - offsets[i], options.rounds,
          [&](const PackedEntries& packed, std::uint32_t* to) {
            Nearest(own.data(), members, packed, to);
          },
          palette.entries.data() + offsets[i] * columns, labels.data());
      for (std::int64_t m = 0; m < members; ++m) {
        palette.labels[cells.rows[static_cast<std::size_t>(begin + m)]] =
            static_cast<std::uint32_t>(offsets[i]) + labels[static_cast<std::size_t>(m)];
      }
    }
  });
  return palette;
}

}  // namespace gsut
#endif
