// Colours from harmonics for vector lanes.

#if defined(GSUT_RASTER_HARMONICS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_HARMONICS_INL_H_
#undef GSUT_RASTER_HARMONICS_INL_H_
#else
#define GSUT_RASTER_HARMONICS_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/gaussians/harmonics.h"
#include "gsut/gaussians/harmonics_rows.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
#include "gsut/gaussians/harmonics_basis.inc"

// Fetches the harmonics of the batch of Gaussians after [first, first + kLanes), which gathers
// would wait for line by line; kWrite: to write there.
template <bool kWrite>
HWY_INLINE void FetchNextHarmonics(const float* sh, const HarmonicsRows& rows, std::int64_t first) {
  constexpr int kLine = 16;  // floats in a cache line
  const std::int64_t size = rows.end[0];
  const std::int64_t begin = rows.Offset(HWY_MIN(first + kLanes, size));
  const std::int64_t end = rows.Offset(HWY_MIN(first + 2 * kLanes, size));
  for (std::int64_t o = begin; o < end; o += kLine) __builtin_prefetch(sh + o, kWrite ? 1 : 0);
}

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

// Colour of each lane from the harmonics up to `degree`, before clamping at 0.
// sh points at the first lane's coefficients, row_offset from there to each lane's.
template <class IndexVec>
HWY_INLINE void EvalColor(int degree, const Lane* direction, const float* sh, IndexVec row_offset,
                          Lane* color) {
  const FloatTag d;
  const hn::RebindToSigned<FloatTag> di;
  Lane basis[kMaxShCoefficients];
  HarmonicsBasis(degree, direction[0], direction[1], direction[2], basis);
  const int coefficients = (degree + 1) * (degree + 1);
  for (int c = 0; c < 3; ++c) color[c] = Lane(0.5);
  for (int k = 0; k < coefficients; ++k) {
    for (int c = 0; c < 3; ++c) {
      const Lane value(hn::GatherIndex(d, sh, hn::Add(row_offset, hn::Set(di, 3 * k + c))));
      color[c] = MulAdd(basis[k], value, color[c]);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
