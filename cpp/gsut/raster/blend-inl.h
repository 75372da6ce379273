// What the tiles' passes share for any lens: the blend of a group of alphas, and
// flags of the run as flags of the build.

#if defined(GSUT_RASTER_BLEND_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_BLEND_INL_H_
#undef GSUT_RASTER_BLEND_INL_H_
#else
#define GSUT_RASTER_BLEND_INL_H_
#endif

#include <type_traits>

#include "gsut/raster/tile_math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Calls run with the flag as a constant (std::true_type or std::false_type), so that there is a
// copy of the text for each. The emulated vectors have one for both: they are slow anyway, and text
// for them takes ten times as long to compile.
template <class Run>
HWY_INLINE void WithFlag(bool flag, const Run& run) {
#if HWY_TARGET == HWY_EMU128
  run(flag);
#else
  if (flag) {
    run(std::true_type());
  } else {
    run(std::false_type());
  }
#endif
}

// Blends kJam alphas, nearest first; pixels below `stop` are closed. Returns whether all are.
// hit: lanes that have an alpha above the cut-off; those left are what was blended.
template <int kJam>
HWY_INLINE bool BlendGroup(bool stop_before, const FloatVec* alpha, FloatVec stop, FloatMask* hit,
                           FloatVec* weight, FloatVec* transmittance_inout, FloatMask* open) {
  const FloatTag d;
  const FloatVec before = *transmittance_inout;
  FloatVec transmittance = before;
  bool all_closed = false;
  GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
    weight[i] = hn::Mul(alpha[i], transmittance);
    transmittance = hn::Sub(transmittance, weight[i]);
  }
  const FloatMask crossed =
      hn::And(*open, stop_before ? hn::Le(transmittance, stop) : hn::Lt(transmittance, stop));
  if (HWY_UNLIKELY(!hn::AllFalse(d, crossed))) {
    // A pixel stops inside this group: once more, Gaussian by Gaussian.
    transmittance = before;
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      FloatMask blends = hn::And(hit[i], hn::Ge(transmittance, stop));
      weight[i] = hn::Mul(alpha[i], transmittance);
      if (stop_before) {
        const FloatMask ends = hn::And(blends, hn::Le(hn::Sub(transmittance, weight[i]), stop));
        transmittance = hn::IfThenElse(ends, hn::Neg(transmittance), transmittance);
        blends = hn::AndNot(ends, blends);
      }
      hit[i] = blends;
      weight[i] = hn::IfThenElseZero(blends, weight[i]);
      transmittance = hn::Sub(transmittance, weight[i]);
    }
    *open = hn::Ge(transmittance, stop);
    all_closed = hn::AllFalse(d, *open);
  }
  *transmittance_inout = transmittance;
  return all_closed;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
