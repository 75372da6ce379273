// Colours from harmonics for vector lanes.

#if defined(GSUT_RASTER_HARMONICS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_HARMONICS_INL_H_
#undef GSUT_RASTER_HARMONICS_INL_H_
#else
#define GSUT_RASTER_HARMONICS_INL_H_
#endif

#include "gsut/gaussians/harmonics.h"
#include "gsut/gaussians/harmonics_rows.h"
#include "gsut/projection/seen-inl.h"
#include "gsut/raster/lane_rows-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
#include "gsut/gaussians/harmonics_basis.inc"

// Where the harmonics of the batch of Gaussians after [first, first + kLanes) stand. They are
// fetched a Gaussian at a time, between computations: a processor that has more requests to memory
// open than it can hold, some twenty, waits.
struct NextHarmonics {
  std::int64_t offset;  // of the first one's
  std::int64_t stride;  // floats of each
  int count;            // Gaussians, up to kLanes

  HWY_INLINE NextHarmonics(const HarmonicsRows& rows, std::int64_t first) {
    const std::int64_t next = HWY_MIN(first + kLanes, rows.end[0]);
    count = static_cast<int>(HWY_MIN(rows.end[0] - next, static_cast<std::int64_t>(kLanes)));
    offset = rows.Offset(next);
    stride = 3 * NumShCoefficients(rows.Degree(next));
  }

  // Fetches the first `floats` of the row of Gaussian i < count; kWrite: to write there.
  template <bool kWrite>
  HWY_INLINE void Fetch(const float* array, int i, std::int64_t floats) const {
    constexpr int kLine = 16;  // floats in a cache line
    const float* row = array + offset + i * stride;
    for (std::int64_t k = 0; k < floats; k += kLine) __builtin_prefetch(row + k, kWrite ? 1 : 0);
  }
};

// The harmonics of the Gaussians [first, first + kLanes), which have one degree.
struct BatchHarmonics {
  std::int64_t offset;  // of the first one's
  int coefficients;     // stored of each
  int degree;           // in use
};

HWY_INLINE BatchHarmonics HarmonicsOf(const HarmonicsRows& rows, int sh_degree,
                                      std::int64_t first) {
  const int stored = rows.Degree(first);
  return {rows.Offset(first), NumShCoefficients(stored), HWY_MIN(stored, sh_degree)};
}

// A vector's harmonics: columns[3 k + c] is channel c of coefficient k.
struct HarmonicsColumns {
  Lane column[PaddedColumns(3 * kMaxShCoefficients)];

  // The coefficients in use of the Gaussians [first, first + kLanes); lanes without one hold any
  // number.
  HWY_INLINE HarmonicsColumns(const float* sh, const HarmonicsRows& rows,
                              const BatchHarmonics& batch, std::int64_t first) {
    const int used = 3 * NumShCoefficients(batch.degree);
    const std::int64_t stride = 3 * batch.coefficients;
    const std::int64_t size = rows.end[0];
    if (batch.coefficients == 1) {
      LoadRows3(sh + batch.offset, size - first, column);
      return;
    }
    // Whole vectors are read, also after the last row's end.
    const std::int64_t readable = rows.Offset(size) - batch.offset;
    if (readable >= (kLanes - 1) * stride + PaddedColumns(used)) {
      LoadColumns(sh + batch.offset, stride, used, column);
      return;
    }
    HWY_ALIGN float padded[kLanes * 3 * kMaxShCoefficients + kLanes] = {};
    const std::int64_t count = HWY_MIN(size - first, static_cast<std::int64_t>(kLanes));
    __builtin_memcpy(padded, sh + batch.offset,
                     sizeof(float) * static_cast<std::size_t>(count * stride));
    LoadColumns(padded, stride, used, column);
  }
};

// Colour of each lane from the harmonics up to `degree`, before clamping at 0.
HWY_INLINE void EvalColor(int degree, const Lane* basis, const HarmonicsColumns& sh, Lane* color) {
  for (int c = 0; c < 3; ++c) color[c] = Lane(0.5);
  const int used = NumShCoefficients(degree);
  for (int k = 0; k < used; ++k) {
    for (int c = 0; c < 3; ++c) color[c] = MulAdd(basis[k], sh.column[3 * k + c], color[c]);
  }
}

// The same of the Gaussians [first, first + kLanes), seen along `direction`.
HWY_INLINE void ColorOf(const float* sh, const HarmonicsRows& rows, int sh_degree,
                        std::int64_t first, const Lane* direction, Lane* color) {
  const BatchHarmonics batch = HarmonicsOf(rows, sh_degree, first);
  Lane basis[kMaxShCoefficients];
  HarmonicsBasis(batch.degree, direction[0], direction[1], direction[2], basis);
  EvalColor(batch.degree, basis, HarmonicsColumns(sh, rows, batch, first), color);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
