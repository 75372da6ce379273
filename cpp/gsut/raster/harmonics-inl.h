// Colours from harmonics for vector lanes.

#if defined(GSUT_RASTER_HARMONICS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_HARMONICS_INL_H_
#undef GSUT_RASTER_HARMONICS_INL_H_
#else
#define GSUT_RASTER_HARMONICS_INL_H_
#endif

#include "gsut/gaussians/harmonics.h"
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

  HWY_INLINE NextHarmonics(const GaussiansView<const float>& g, std::int64_t first) {
    const std::int64_t next = HWY_MIN(first + kLanes, g.size);
    count = static_cast<int>(HWY_MIN(g.size - next, static_cast<std::int64_t>(kLanes)));
    stride = 3 * g.sh_coefficients;
    offset = next * stride;
  }

  // Fetches the first `floats` of the row of Gaussian i < count; kWrite: to write there.
  template <bool kWrite>
  HWY_INLINE void Fetch(const float* array, int i, std::int64_t floats) const {
    constexpr int kLine = 16;  // floats in a cache line
    const float* row = array + offset + i * stride;
    for (std::int64_t k = 0; k < floats; k += kLine) __builtin_prefetch(row + k, kWrite ? 1 : 0);
  }
};

// A vector's harmonics: columns[3 k + c] is channel c of coefficient k.
struct HarmonicsColumns {
  Lane column[PaddedColumns(3 * kMaxShCoefficients)];

  // The coefficients up to `degree` of the Gaussians [first, first + kLanes); lanes without one
  // hold any number.
  HWY_INLINE HarmonicsColumns(const GaussiansView<const float>& g, int degree, std::int64_t first) {
    const int used = 3 * NumShCoefficients(degree);
    const std::int64_t stride = 3 * g.sh_coefficients;
    const float* sh = g.sh + first * stride;
    if (g.sh_coefficients == 1) {
      LoadRows3(sh, g.size - first, column);
      return;
    }
    // Whole vectors are read, also after the last row's end.
    const std::int64_t readable = (g.size - first) * stride;
    if (readable >= (kLanes - 1) * stride + PaddedColumns(used)) {
      LoadColumns(sh, stride, used, column);
      return;
    }
    HWY_ALIGN float padded[kLanes * 3 * kMaxShCoefficients + kLanes] = {};
    const std::int64_t count = HWY_MIN(g.size - first, static_cast<std::int64_t>(kLanes));
    __builtin_memcpy(padded, sh, sizeof(float) * static_cast<std::size_t>(count * stride));
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
HWY_INLINE void ColorOf(const GaussiansView<const float>& g, int degree, std::int64_t first,
                        const Lane* direction, Lane* color) {
  Lane basis[kMaxShCoefficients];
  HarmonicsBasis(degree, direction[0], direction[1], direction[2], basis);
  EvalColor(degree, basis, HarmonicsColumns(g, degree, first), color);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
