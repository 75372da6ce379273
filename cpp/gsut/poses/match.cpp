// Brute-force matching: a small matrix product that keeps the two largest of each row and column.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/poses/match.cpp"
#include "gsut/base/hwy_targets.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "gsut/base/aligned_vector.h"
#include "gsut/base/errors.h"
#include "gsut/poses/match.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

using DF = hn::ScalableTag<float>;
using VF = hn::Vec<DF>;

// Accumulators: rows x vectors. AVX-512 has 32 registers, the others 16.
#if HWY_TARGET == HWY_AVX3
constexpr int kRows = 8;
#else
constexpr int kRows = 4;
#endif
constexpr int kVectors = 2;
// Columns packed and kept in the second-level cache meanwhile: 128 KiB.
constexpr int kBlockColumns = 256;
constexpr float kNone = -2.0F;  // below every cosine
// |a - b|^2 = 2 - 2 a b; below this, rounding of the cosine decides.
constexpr float kSmallestSquared = 1e-12F;

// The two largest cosines of one feature, and where the largest is.
struct TwoBest {
  float best = kNone, second = kNone;
  std::int32_t index = -1;
  void Add(float value, std::int32_t at) {
    if (value > best) {
      second = best;
      best = value;
      index = at;
    } else if (value > second) {
      second = value;
    }
  }
};

// The same for the lanes of a vector; indices as floats, exact below 2^24.
struct Lanes {
  VF best, second, index;
};

HWY_INLINE void AddLanes(Lanes& lanes, VF value, VF index) {
  const auto larger = hn::Gt(value, lanes.best);
  lanes.second = hn::Max(lanes.second, hn::Min(lanes.best, value));
  lanes.best = hn::Max(lanes.best, value);
  lanes.index = hn::IfThenElse(larger, index, lanes.index);
}

// Columns [begin, begin + kBlockColumns) of `second`, dimension by dimension, missing ones as 0.
void Pack(const float* second, int num_second, int begin, float* packed) {
  for (int k = 0; k < kDescriptorLength; ++k) {
    for (int j = 0; j < kBlockColumns; ++j) {
      const int column = begin + j;
      packed[k * kBlockColumns + j] =
          column < num_second ? second[static_cast<std::int64_t>(column) * kDescriptorLength + k]
                              : 0.0F;
    }
  }
}

void FindBest(const float* first, int num_first, const float* second, int num_second,
              TwoBest* of_first, TwoBest* of_second) {
  const DF d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const int step = kVectors * lanes;
  AlignedVector<float> packed(static_cast<std::size_t>(kDescriptorLength) * kBlockColumns);
  AlignedVector<float> columns(static_cast<std::size_t>(3) * kBlockColumns);
  AlignedVector<float> spill(static_cast<std::size_t>(3) * lanes);
  // Rows past the end repeat the last one, in a copy, and their results are not read.
  AlignedVector<float> tail(static_cast<std::size_t>(kRows) * kDescriptorLength);
  for (int begin = 0; begin < num_second; begin += kBlockColumns) {
    const int block = std::min(kBlockColumns, num_second - begin);
    Pack(second, num_second, begin, packed.data());
    float* best = columns.data();
    float* next = best + kBlockColumns;
    float* where = next + kBlockColumns;
    std::fill(best, best + kBlockColumns, kNone);
    std::fill(next, next + kBlockColumns, kNone);
    std::fill(where, where + kBlockColumns, -1.0F);
    for (int row = 0; row < num_first; row += kRows) {
      const int rows = std::min(kRows, num_first - row);
      const float* a = first + static_cast<std::int64_t>(row) * kDescriptorLength;
      if (rows < kRows) {
        for (int r = 0; r < kRows; ++r) {
          std::copy_n(a + std::min(r, rows - 1) * kDescriptorLength, kDescriptorLength,
                      tail.data() + r * kDescriptorLength);
        }
        a = tail.data();
      }
      Lanes of_row[kRows];
      for (int r = 0; r < kRows; ++r) {
        of_row[r] = {hn::Set(d, kNone), hn::Set(d, kNone), hn::Zero(d)};
      }
      for (int j = 0; j < block; j += step) {
        VF sums[kRows][kVectors];
        for (int r = 0; r < kRows; ++r) {
          for (int v = 0; v < kVectors; ++v) sums[r][v] = hn::Zero(d);
        }
        const float* b = packed.data() + j;
        for (int k = 0; k < kDescriptorLength; ++k, b += kBlockColumns) {
          VF column[kVectors];
          for (int v = 0; v < kVectors; ++v) column[v] = hn::Load(d, b + v * lanes);
          for (int r = 0; r < kRows; ++r) {
            const VF value = hn::Set(d, a[r * kDescriptorLength + k]);
            for (int v = 0; v < kVectors; ++v) {
              sums[r][v] = hn::MulAdd(value, column[v], sums[r][v]);
            }
          }
        }
        for (int v = 0; v < kVectors; ++v) {
          const int at = j + v * lanes;
          if (at >= block) break;
          const VF index = hn::Add(hn::Iota(d, 0.0F), hn::Set(d, static_cast<float>(begin + at)));
          const auto there = hn::Lt(index, hn::Set(d, static_cast<float>(num_second)));
          Lanes of_column = {hn::Load(d, best + at), hn::Load(d, next + at),
                             hn::Load(d, where + at)};
          for (int r = 0; r < kRows; ++r) {
            const VF value = hn::IfThenElse(there, sums[r][v], hn::Set(d, kNone));
            AddLanes(of_row[r], value, index);
            if (r < rows) AddLanes(of_column, value, hn::Set(d, static_cast<float>(row + r)));
          }
          hn::Store(of_column.best, d, best + at);
          hn::Store(of_column.second, d, next + at);
          hn::Store(of_column.index, d, where + at);
        }
      }
      for (int r = 0; r < rows; ++r) {
        hn::Store(of_row[r].best, d, spill.data());
        hn::Store(of_row[r].second, d, spill.data() + lanes);
        hn::Store(of_row[r].index, d, spill.data() + 2 * lanes);
        TwoBest& total = of_first[row + r];
        for (int lane = 0; lane < lanes; ++lane) {
          total.Add(spill[lane], static_cast<std::int32_t>(spill[2 * lanes + lane]));
          total.second = std::max(total.second, spill[lanes + lane]);
        }
      }
    }
    for (int j = 0; j < block; ++j) {
      of_second[begin + j] = {best[j], next[j], static_cast<std::int32_t>(where[j])};
    }
  }
}

}  // namespace

std::vector<FeatureMatch> Match(const float* first, int num_first, const float* second,
                                int num_second, const MatchOptions& options) {
  std::vector<TwoBest> of_first(num_first), of_second(num_second);
  FindBest(first, num_first, second, num_second, of_first.data(), of_second.data());
  const auto squared = [](float cosine) {
    return std::max(kSmallestSquared, 2.0F - 2.0F * cosine);
  };
  const auto ratio = [&](const TwoBest& two) {
    return std::sqrt(squared(two.best) / squared(two.second));
  };
  std::vector<FeatureMatch> matches;
  for (int i = 0; i < num_first; ++i) {
    const int j = of_first[i].index;
    if (j < 0 || of_second[j].index != i) continue;
    const FeatureMatch match = {i, j, std::sqrt(squared(of_first[i].best)),
                                std::max(ratio(of_first[i]), ratio(of_second[j]))};
    if (match.ratio <= options.max_ratio && match.distance <= options.max_distance) {
      matches.push_back(match);
    }
  }
  std::stable_sort(matches.begin(), matches.end(),
                   [](const FeatureMatch& a, const FeatureMatch& b) { return a.ratio < b.ratio; });
  return matches;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {

HWY_EXPORT(Match);

std::vector<FeatureMatch> MatchDescriptors(const float* first, int num_first, const float* second,
                                           int num_second, const MatchOptions& options) {
  if (num_first < 0 || num_second < 0) throw InputError("a number of descriptors is negative");
  return HWY_DYNAMIC_DISPATCH(Match)(first, num_first, second, num_second, options);
}

}  // namespace gsut
#endif  // HWY_ONCE
