// Brute-force matching: a small matrix product that keeps the two largest of each row and column.
// Products of bytes add up to less than 2^24, so floats hold them exactly and every kernel gives
// the same bits.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/sfm/match.cpp"
#include "gsut/base/hwy_targets.h"
// Here, and only here, also AVX-512 with dot products of bytes (VNNI): 64 products an instruction
// instead of 16.
#define HWY_WANT_AVX3_DL
#undef HWY_DISABLED_TARGETS
#define HWY_DISABLED_TARGETS                                                              \
  ((1LL << 4) | (1LL << 6) | HWY_SSSE3 | (1LL << 14) | HWY_SVE | HWY_SVE2 | HWY_SVE_256 | \
   HWY_SVE2_128 | GSUT_BETTER_TARGETS)
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "gsut/base/aligned_vector.h"
#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/sfm/match.h"

#ifndef GSUT_SFM_MATCH_DESCRIPTORS
#define GSUT_SFM_MATCH_DESCRIPTORS
namespace gsut {

// Columns packed at a time, small enough to stay in the second-level cache: 128 KiB as floats.
constexpr int kBlockColumns = 256;

// The job: for each of N descriptors the two nearest of M others, and the other way round, in one
// pass over the N x M cosines. That is a matrix product whose result is never stored: each cosine
// updates the two best of its row and of its column while it is in a register.
//   a block of columns is packed (SetColumns) so that a vector holds several columns' k-th entries;
//   kRows rows at a time run over it, kRows x kVectors sums in registers (Find);
//   rows keep their two best in lanes until the block ends, columns in a small array beside it.

struct Descriptors {
  const std::uint8_t* bytes;
  int count;
  // Of each, and zeros up to a whole block of columns.
  AlignedVector<float> inverse_length;  // 0 where it has none
  AlignedVector<std::int32_t> sum;
  const std::uint8_t* Row(int index) const {
    return bytes + std::int64_t{index} * kDescriptorLength;
  }
};

}  // namespace gsut
#endif

#if HWY_TARGET == HWY_AVX3_DL
// Highway asks the processor for the last one, but leaves it out of the compiler's options.
HWY_PUSH_ATTRIBUTES(HWY_TARGET_STR ",avx512vnni")
#else
HWY_BEFORE_NAMESPACE();
#endif
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

using DF = hn::ScalableTag<float>;
using VF = hn::Vec<DF>;

// Accumulators: rows x vectors. AVX-512 has 32 registers, the others 16.
#if HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_AVX3_DL
constexpr int kRows = 8;
#else
constexpr int kRows = 4;
#endif
constexpr int kVectors = 2;
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

// The new second best is the smaller of value and best, if that is above the old one.
HWY_INLINE void AddLanes(Lanes& lanes, VF value, VF index) {
  const auto larger = hn::Gt(value, lanes.best);
  lanes.second = hn::Max(lanes.second, hn::Min(lanes.best, value));
  lanes.best = hn::Max(lanes.best, value);
  lanes.index = hn::IfThenElse(larger, index, lanes.index);
}

// Dot products of kRows rows with kVectors vectors of columns, of a packed block.
class Products {
 public:
  explicit Products(const Descriptors& second)
      : second_(second), columns_(kDescriptorLength * kBlockColumns) {}

  // Packs a block of columns; zeros behind the last one give cosines of 0, which are not used.
  void SetColumns(int begin) {
    const int count = std::min(kBlockColumns, second_.count - begin);
    std::fill(columns_.begin(), columns_.end(), Column{0});
    for (int k = 0; k < kDescriptorLength; ++k) {
      for (int j = 0; j < count; ++j) columns_[PlaceOf(j, k)] = second_.Row(begin + j)[k];
    }
    sums_ = second_.sum.data() + begin;
  }

  void SetRow(int r, const std::uint8_t* from) {
    for (int k = 0; k < kDescriptorLength; ++k) {
      rows_[r * kDescriptorLength + k] = static_cast<Row>(from[k] - kOffset);
    }
  }

  HWY_INLINE void Find(int j, VF (&out)[kRows][kVectors]) const;

 private:
#if HWY_TARGET == HWY_AVX3_DL
  // Four dimensions of a descriptor stand side by side. The instruction multiplies bytes without a
  // sign by bytes with one: rows are kept less 128, which the columns' sums make up for.
  using Row = std::int8_t;
  using Column = std::uint8_t;
  static constexpr int kOffsetBits = 7;
  static constexpr int kOffset = 1 << kOffsetBits;
  static int PlaceOf(int j, int k) { return (k / 4 * kBlockColumns + j) * 4 + k % 4; }
#else
  using Row = float;
  using Column = float;
  static constexpr int kOffset = 0;
  static int PlaceOf(int j, int k) { return k * kBlockColumns + j; }
#endif
  const Descriptors& second_;
  const std::int32_t* sums_ = nullptr;  // of the block
  AlignedVector<Column> columns_;
  std::array<Row, kRows * kDescriptorLength> rows_;
};

#if HWY_TARGET == HWY_AVX3_DL
HWY_INLINE void Products::Find(int j, VF (&out)[kRows][kVectors]) const {
  const hn::ScalableTag<std::int32_t> di;
  constexpr int kLanes = 16;
  hn::Vec<decltype(di)> sums[kRows][kVectors];
  for (int r = 0; r < kRows; ++r) {
    for (int v = 0; v < kVectors; ++v) {
      sums[r][v] = hn::ShiftLeft<kOffsetBits>(hn::Load(di, sums_ + j + v * kLanes));
    }
  }
  // sum of (row - 128) column = sum of row column - 128 sum of column: the start value adds it
  // back.
  const auto* column = reinterpret_cast<const std::int32_t*>(columns_.data()) + j;
  for (int k = 0; k < kDescriptorLength; k += 4, column += kBlockColumns) {
    for (int r = 0; r < kRows; ++r) {
      std::int32_t four;
      std::memcpy(&four, &rows_[r * kDescriptorLength + k], sizeof(four));
      const auto row = hn::Set(di, four);
      for (int v = 0; v < kVectors; ++v) {
        sums[r][v].raw =
            _mm512_dpbusd_epi32(sums[r][v].raw, hn::Load(di, column + v * kLanes).raw, row.raw);
      }
    }
  }
  for (int r = 0; r < kRows; ++r) {
    for (int v = 0; v < kVectors; ++v) out[r][v] = hn::ConvertTo(DF(), sums[r][v]);
  }
}
#else
HWY_INLINE void Products::Find(int j, VF (&out)[kRows][kVectors]) const {
  const DF d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int r = 0; r < kRows; ++r) {
    for (int v = 0; v < kVectors; ++v) out[r][v] = hn::Zero(d);
  }
  const float* column = columns_.data() + j;
  for (int k = 0; k < kDescriptorLength; ++k, column += kBlockColumns) {
    VF columns[kVectors];
    for (int v = 0; v < kVectors; ++v) columns[v] = hn::Load(d, column + v * lanes);
    for (int r = 0; r < kRows; ++r) {
      const VF row = hn::Set(d, rows_[r * kDescriptorLength + k]);
      for (int v = 0; v < kVectors; ++v) out[r][v] = hn::MulAdd(row, columns[v], out[r][v]);
    }
  }
}
#endif

void FindBest(const Descriptors& first, const Descriptors& second, TwoBest* of_first,
              TwoBest* of_second) {
  const DF d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const int step = kVectors * lanes;
  const int num_first = first.count, num_second = second.count;
  Products products(second);
  AlignedVector<float> columns(static_cast<std::size_t>(3) * kBlockColumns);
  AlignedVector<float> spill(static_cast<std::size_t>(3) * lanes);
  for (int begin = 0; begin < num_second; begin += kBlockColumns) {
    const int block = std::min(kBlockColumns, num_second - begin);
    products.SetColumns(begin);
    float* best = columns.data();
    float* next = best + kBlockColumns;
    float* where = next + kBlockColumns;
    std::fill(best, best + kBlockColumns, kNone);
    std::fill(next, next + kBlockColumns, kNone);
    std::fill(where, where + kBlockColumns, -1.0F);
    for (int row = 0; row < num_first; row += kRows) {
      const int rows = std::min(kRows, num_first - row);
      // At the bottom there may be fewer rows than registers.
      // Rows past the end repeat the last one, and their results are not read.
      Lanes of_row[kRows];
      VF scale[kRows];
      for (int r = 0; r < kRows; ++r) {
        const int at = row + std::min(r, rows - 1);
        products.SetRow(r, first.Row(at));
        scale[r] = hn::Set(d, first.inverse_length[at]);
        of_row[r] = {hn::Set(d, kNone), hn::Set(d, kNone), hn::Zero(d)};
      }
      for (int j = 0; j < block; j += step) {
        VF sums[kRows][kVectors];
        products.Find(j, sums);
        for (int v = 0; v < kVectors; ++v) {
          const int at = j + v * lanes;
          if (at >= block) break;
          const VF index = hn::Add(hn::Iota(d, 0.0F), hn::Set(d, static_cast<float>(begin + at)));
          const VF of_columns = hn::Load(d, &second.inverse_length[begin + at]);
          const auto there = hn::Lt(index, hn::Set(d, static_cast<float>(num_second)));
          Lanes of_column = {hn::Load(d, best + at), hn::Load(d, next + at),
                             hn::Load(d, where + at)};
          for (int r = 0; r < kRows; ++r) {
            const VF cosine = hn::Mul(hn::Mul(sums[r][v], scale[r]), of_columns);
            const VF value = hn::IfThenElse(there, cosine, hn::Set(d, kNone));
            AddLanes(of_row[r], value, index);
            if (r < rows) AddLanes(of_column, value, hn::Set(d, static_cast<float>(row + r)));
          }
          hn::Store(of_column.best, d, best + at);
          hn::Store(of_column.second, d, next + at);
          hn::Store(of_column.index, d, where + at);
        }
      }
      // The row's best over this block: the lanes' bests compete, then all seconds.
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
    // A column has met all rows now.
    for (int j = 0; j < block; ++j) {
      of_second[begin + j] = {best[j], next[j], static_cast<std::int32_t>(where[j])};
    }
  }
}

}  // namespace

std::vector<FeatureMatch> Match(const Descriptors& first, const Descriptors& second,
                                const MatchOptions& options) {
  std::vector<TwoBest> of_first(first.count), of_second(second.count);
  FindBest(first, second, of_first.data(), of_second.data());
  // Lowe's ratio test in both directions, on matches that are each other's best.
  const auto squared = [](float cosine) {
    return std::max(kSmallestSquared, 2.0F - 2.0F * cosine);
  };
  const auto ratio = [&](const TwoBest& two) {
    return std::sqrt(squared(two.best) / squared(two.second));
  };
  std::vector<FeatureMatch> matches;
  for (int i = 0; i < first.count; ++i) {
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

const char* Kernel() { return hwy::TargetName(HWY_TARGET); }

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {

HWY_EXPORT(Match);
HWY_EXPORT(Kernel);

namespace {

// Lengths for cosines, and sums of bytes, which make up for the offset of signed rows.
Descriptors SumDescriptors(const std::uint8_t* bytes, int count) {
  const int padded = (count + kBlockColumns - 1) / kBlockColumns * kBlockColumns;
  Descriptors all = {bytes, count, AlignedVector<float>(padded, 0.0F),
                     AlignedVector<std::int32_t>(padded, 0)};
  for (int i = 0; i < count; ++i) {
    const std::uint8_t* from = all.Row(i);
    std::int32_t squares = 0;
    for (int k = 0; k < kDescriptorLength; ++k) {
      all.sum[i] += from[k];
      squares += from[k] * from[k];
    }
    if (squares > 0) all.inverse_length[i] = 1.0F / std::sqrt(static_cast<float>(squares));
  }
  return all;
}

}  // namespace

std::vector<FeatureMatch> MatchDescriptors(const std::uint8_t* first, int num_first,
                                           const std::uint8_t* second, int num_second,
                                           const MatchOptions& options) {
  CheckArray(first, num_first, "first");
  CheckArray(second, num_second, "second");
  return HWY_DYNAMIC_DISPATCH(Match)(SumDescriptors(first, num_first),
                                     SumDescriptors(second, num_second), options);
}

const char* MatchKernel() { return HWY_DYNAMIC_DISPATCH(Kernel)(); }

}  // namespace gsut
#endif  // HWY_ONCE
