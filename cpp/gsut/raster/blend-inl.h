// Blends a group of alphas, for any lens, and makes flags of the run flags of the build.

#if defined(GSUT_RASTER_BLEND_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_BLEND_INL_H_
#undef GSUT_RASTER_BLEND_INL_H_
#else
#define GSUT_RASTER_BLEND_INL_H_
#endif

#include <type_traits>

#include "gsut/raster/blend_rule.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/task.h"
#include "gsut/raster/tile_grid.h"
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

// The alpha of raw under extinction; raw counts halvings of the light.
HWY_INLINE FloatVec ExtinctionAlpha(FloatVec raw) {
  return hn::Sub(hn::Set(FloatTag(), 1.0f), FastExp2(hn::Neg(raw)));
}

// Where pixels end, see BlendRule::transmittance_min and stop_before.
struct StopRule {
  FloatVec stop;      // pixels with less light are closed
  FloatVec crossing;  // a group that leaves less closes a pixel
  bool is_before;     // the Gaussian that closes a pixel is not blended
  HWY_INLINE explicit StopRule(const RasterTask& task)
      : stop(hn::Set(FloatTag(), task.transmittance_min)),
        crossing(hn::Set(FloatTag(), task.crossing)),
        is_before(task.stop_before) {}
};

// Blends kJam alphas, nearest first. Returns whether all pixels are closed.
// hit: lanes that have an alpha above the cut-off; those left are what was blended.
template <int kJam>
HWY_INLINE bool BlendGroup(const StopRule& rule, const FloatVec* alpha, FloatMask* hit,
                           FloatVec* weight, FloatVec* transmittance_inout, FloatMask* open) {
  const FloatTag d;
  const FloatVec before = *transmittance_inout;
  FloatVec transmittance = before;
  bool all_closed = false;
  GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
    weight[i] = hn::Mul(alpha[i], transmittance);
    transmittance = hn::Sub(transmittance, weight[i]);
  }
  const FloatMask crossed = hn::And(*open, hn::Lt(transmittance, rule.crossing));
  if (HWY_UNLIKELY(!hn::AllFalse(d, crossed))) {
    // A pixel stops inside this group: once more, Gaussian by Gaussian.
    transmittance = before;
    GSUT_UNROLL for (int i = 0; i < kJam; ++i) {
      FloatMask blends = hn::And(hit[i], hn::Ge(transmittance, rule.stop));
      weight[i] = hn::Mul(alpha[i], transmittance);
      if (rule.is_before) {
        const FloatVec left = hn::Sub(transmittance, weight[i]);
        const FloatMask ends = hn::And(blends, hn::Le(left, rule.stop));
        transmittance = hn::IfThenElse(ends, hn::Neg(transmittance), transmittance);
        blends = hn::AndNot(ends, blends);
      }
      hit[i] = blends;
      weight[i] = hn::IfThenElseZero(blends, weight[i]);
      transmittance = hn::Sub(transmittance, weight[i]);
    }
    *open = hn::Ge(transmittance, rule.stop);
    all_closed = hn::AllFalse(d, *open);
  }
  *transmittance_inout = transmittance;
  return all_closed;
}

// What the distances of a block's Gaussians add up to. Squares are taken about the first distance,
// so that little is lost in their difference.
struct DepthSums {
  FloatVec depth, first, moment;

  static HWY_INLINE DepthSums Zero() {
    const FloatTag d;
    return {hn::Zero(d), hn::Zero(d), hn::Zero(d)};
  }
  // along: 0 where the Gaussian is not blended.
  HWY_INLINE void Add(FloatVec weight, FloatVec along) {
    const FloatTag d;
    depth = hn::MulAdd(weight, along, depth);
    first = hn::IfThenElse(hn::Eq(first, hn::Zero(d)), along, first);
    const FloatVec from_first = hn::Sub(along, first);
    moment = hn::MulAdd(hn::Mul(weight, from_first), from_first, moment);
  }
};

HWY_INLINE DepthSums LoadDepth(const Frame& frame, std::size_t o) {
  const FloatTag d;
  return {hn::Load(d, &frame.depth[o]), hn::Load(d, &frame.first_depth[o]),
          hn::Load(d, &frame.depth_moment[o])};
}

HWY_INLINE void StoreDepth(const DepthSums& sums, std::size_t o, Frame* frame) {
  const FloatTag d;
  hn::Store(sums.depth, d, &frame->depth[o]);
  hn::Store(sums.first, d, &frame->first_depth[o]);
  hn::Store(sums.moment, d, &frame->depth_moment[o]);
}

// What the backward pass needs of a block's pixels for a loss of their distances.
struct DepthOfBlock {
  FloatVec mean, distortion;  // 0 where the distortion counts as 0

  HWY_INLINE DepthOfBlock(const TileGrid& grid, const Frame& frame, std::size_t o) {
    const FloatTag d;
    const FloatVec alpha =
        hn::Sub(hn::Load(d, &grid.start[o]), hn::Abs(hn::Load(d, &frame.transmittance[o])));
    const FloatMask counts = hn::Ge(alpha, hn::Set(d, static_cast<float>(kDistortionAlpha)));
    const FloatVec share = hn::Div(hn::IfThenElseZero(counts, hn::Set(d, 1.0f)),
                                   hn::IfThenElse(counts, alpha, hn::Set(d, 1.0f)));
    const DepthSums sums = LoadDepth(frame, o);
    mean = hn::Mul(sums.depth, share);
    const FloatVec shift = hn::NegMulAdd(alpha, sums.first, sums.depth);
    distortion = hn::Max(hn::NegMulAdd(hn::Mul(shift, shift), share, sums.moment), hn::Zero(d));
    distortion = hn::IfThenElseZero(counts, distortion);
  }
};

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
