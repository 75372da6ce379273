// The harmonics' polynomials for vector lanes.

#if defined(GSUT_RASTER_HARMONICS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_HARMONICS_INL_H_
#undef GSUT_RASTER_HARMONICS_INL_H_
#else
#define GSUT_RASTER_HARMONICS_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/gaussians/harmonics.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
#include "gsut/gaussians/harmonics_basis.inc"
}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
