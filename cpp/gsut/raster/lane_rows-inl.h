// Rows of floats in memory <-> one Gaussian a lane, a register a column.

#if defined(GSUT_RASTER_LANE_ROWS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LANE_ROWS_INL_H_
#undef GSUT_RASTER_LANE_ROWS_INL_H_
#else
#define GSUT_RASTER_LANE_ROWS_INL_H_
#endif

#include "gsut/raster/tile_math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Columns are dealt with kLanes at a time: arrays of them are padded to that.
constexpr int PaddedColumns(int columns) { return (columns + kLanes - 1) / kLanes * kLanes; }

// Exchanges lane j of v[i] and lane i of v[j]. One or two shuffles a vector and doubling, where
// gathers take one load a lane.
HWY_INLINE void TransposeLanes(FloatVec* v) {
  const FloatTag d;
#if HWY_MAX_BYTES == 64
  GSUT_UNROLL for (int i = 0; i < 8; ++i) {
    const FloatVec a = v[i], b = v[i + 8];
    v[i] = hn::ConcatLowerLower(d, b, a);
    v[i + 8] = hn::ConcatUpperUpper(d, b, a);
  }
#endif
  if constexpr (kLanes >= 8) {
    GSUT_UNROLL for (int i = 0; i < kLanes; i += 8) {
      GSUT_UNROLL for (int j = i; j < i + 4; ++j) {
        const FloatVec a = v[j], b = v[j + 4];
        v[j] = hn::OddEvenBlocks(hn::SwapAdjacentBlocks(b), a);
        v[j + 4] = hn::OddEvenBlocks(b, hn::SwapAdjacentBlocks(a));
      }
    }
  }
  GSUT_UNROLL for (int i = 0; i < kLanes; i += 4) {
    const FloatVec even_low = hn::InterleaveLower(d, v[i], v[i + 2]);
    const FloatVec even_high = hn::InterleaveUpper(d, v[i], v[i + 2]);
    const FloatVec odd_low = hn::InterleaveLower(d, v[i + 1], v[i + 3]);
    const FloatVec odd_high = hn::InterleaveUpper(d, v[i + 1], v[i + 3]);
    v[i] = hn::InterleaveLower(d, even_low, odd_low);
    v[i + 1] = hn::InterleaveUpper(d, even_low, odd_low);
    v[i + 2] = hn::InterleaveLower(d, even_high, odd_high);
    v[i + 3] = hn::InterleaveUpper(d, even_high, odd_high);
  }
}

// columns[c], lane i = rows[i * stride + c] for c < count; reads and writes PaddedColumns(count).
HWY_INLINE void LoadColumns(const float* rows, std::int64_t stride, int count, Lane* columns) {
  const FloatTag d;
  for (int c = 0; c < count; c += kLanes) {
    FloatVec v[kLanes];
    GSUT_UNROLL for (int i = 0; i < kLanes; ++i) v[i] = hn::LoadU(d, rows + i * stride + c);
    TransposeLanes(v);
    GSUT_UNROLL for (int i = 0; i < kLanes; ++i) columns[c + i].v = v[i];
  }
}

// The first `available` rows of `stride` floats, all of them written and nothing after them.
HWY_INLINE void StoreColumns(const Lane* columns, std::int64_t stride, std::int64_t available,
                             float* rows) {
  const FloatTag d;
  const std::int64_t count = HWY_MIN(available, static_cast<std::int64_t>(kLanes));
  // A row's last vector may reach into the next rows: those are written after it.
  for (std::int64_t c = (stride - 1) / kLanes * kLanes; c >= 0; c -= kLanes) {
    FloatVec v[kLanes];
    GSUT_UNROLL for (int i = 0; i < kLanes; ++i) v[i] = columns[c + i].v;
    TransposeLanes(v);
    HWY_ALIGN float last[kLanes];
    GSUT_UNROLL for (int i = 0; i < kLanes; ++i) {
      const std::int64_t at = i * stride + c;
      if (at + kLanes <= count * stride) {
        hn::StoreU(v[i], d, rows + at);
      } else if (i < count) {
        hn::Store(v[i], d, last);
        for (std::int64_t k = 0; k < HWY_MIN(stride - c, std::int64_t{kLanes}); ++k) {
          rows[at + k] = last[k];
        }
      }
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
