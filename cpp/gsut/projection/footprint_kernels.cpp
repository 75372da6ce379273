// The vectorised footprints, compiled once per instruction set and lens.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/projection/footprint_kernels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <cmath>
#include <type_traits>

#include "gsut/base/lanes-inl.h"
#include "gsut/cameras/contract.h"
#include "gsut/cameras/lens_registry.h"
#include "gsut/projection/dual_lanes-inl.h"
#include "gsut/projection/footprint_kernels.h"
#include "gsut/projection/project_kernels.h"
#include "gsut/projection/seen-inl.h"
#include "gsut/projection/footprint-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace lane_lenses {
#include "gsut_lens_files.inc"
}  // namespace lane_lenses

using LaneFootprint = PlacedFootprint<Lane, LaneMask>;

// Stores footprints and states of the lanes from i on.
HWY_INLINE void StoreFootprints(const LaneFootprint& f, LaneMask possible, std::int64_t i,
                                int count, Footprints<float>* out) {
  const FloatTag d;
  const LaneMask whole =
      AndMask(AndMask(possible, f.valid), IsFinite(f.low_u + f.high_u + f.low_v + f.high_v));
  const Lane nan(static_cast<double>(__builtin_nanf(""))), rounding(kBoxRounding);
  const Lane high(1.0), low(-1.0);
  const auto store = [&](Lane value, AlignedVector<float>* array) HWY_ATTR {
    hn::StoreU(value.v, d, &(*array)[static_cast<std::size_t>(i)]);
  };
  store(Select(f.valid, f.u, nan), &out->u);
  store(Select(f.valid, f.v, nan), &out->v);
  store(Select(f.valid, f.cov_uu, nan), &out->cov_uu);
  store(Select(f.valid, f.cov_uv, nan), &out->cov_uv);
  store(Select(f.valid, f.cov_vv, nan), &out->cov_vv);
  store(Select(whole, f.low_u - rounding, high), &out->low_u);
  store(Select(whole, f.high_u + rounding, low), &out->high_u);
  store(Select(whole, f.low_v - rounding, high), &out->low_v);
  store(Select(whole, f.high_v + rounding, low), &out->high_v);
  const std::uint64_t is_box = MaskBits(whole.m), is_possible = MaskBits(possible.m);
  for (int k = 0; k < count; ++k) {
    const std::size_t j = static_cast<std::size_t>(i + k);
    out->status[j] = (is_box >> k) & 1        ? FootprintStatus::kBox
                     : (is_possible >> k) & 1 ? FootprintStatus::kUnknown
                                              : FootprintStatus::kNothing;
  }
}

template <class Lens>
void FootprintsOfLens(const FootprintTask& task, std::int64_t begin, std::int64_t end,
                      Footprints<float>* out) {
  constexpr bool kHasTable = requires { Lens::kHasTable; };
  Lane broadcast[kMaxLensParams];
  DualLane constants[kMaxLensParams];
  if constexpr (!kHasTable) {
    for (int i = 0; i < task.num_params; ++i) {
      broadcast[i] = Lane(task.params[i]);
      constants[i] = DualLane(task.params[i]);
    }
  }
  const auto params_as = [&](auto* values) {
    if constexpr (kHasTable) {
      return task.table;
    } else {
      return static_cast<std::add_const_t<std::remove_pointer_t<decltype(values)>>*>(values);
    }
  };
  const auto* params = params_as(&broadcast[0]);
  const auto* dual_params = params_as(&constants[0]);
  const ImagePeriod period = PeriodOf<Lens>(task.domain, task.params);
  double circle[kOutlinePoints][2];
  for (int k = 0; k < kOutlinePoints; ++k) {
    circle[k][0] = std::cos(2.0 * kPi * k / kOutlinePoints);
    circle[k][1] = std::sin(2.0 * kPi * k / kOutlinePoints);
  }
  for (std::int64_t i = begin; i < end; i += kLanes) {
    const int count = static_cast<int>(HWY_MIN(end - i, static_cast<std::int64_t>(kLanes)));
    const SeenLanes seen =
        LoadSeen(task.gaussians, i, task.view, task.log2_alpha_min, task.max_cutoff);
    PlacedGaussian<Lane> g;
    Lane g2(0.0);
    for (int k = 0; k < 3; ++k) {
      g.mean[k] = seen.mean[k];
      g.scale[k] = seen.scale[k];
      for (int row = 0; row < 3; ++row) g.axes[k][row] = seen.axes[k][row];
      const Lane whitened = Dot3(seen.axes[k], seen.mean) / seen.scale[k];
      g2 += whitened * whitened;
    }
    g.reach = Sqrt(Max(seen.cutoff, Lane(0.0)));
    // What can be seen at all: as in project_kernels.cpp.
    const LaneMask finite =
        AndMask(IsFinite(g2), IsFinite(g.mean[0] + g.mean[1] + g.mean[2] + seen.distance));
    const Lane size = Max(g.scale[0], Max(g.scale[1], g.scale[2])) / seen.distance;
    const Lane sine = Min(g.reach * size, Lane(1.0));
    const Lane mean_angle = Atan2(Sqrt(g.mean[0] * g.mean[0] + g.mean[1] * g.mean[1]), g.mean[2]);
    constexpr double kAngleSlack = 1e-5;  // float rounding of the angle
    const LaneMask outside_domain =
        AndMask(sine<Lane(1.0), mean_angle - Asin(sine)> Lane(task.domain.max_angle + kAngleSlack));
    const LaneMask possible = AndMask(
        AndMask(AndMask(seen.usable, finite), seen.distance > Lane(0.0)), NotMask(outside_domain));
    LaneFootprint f;
    switch (task.method) {
      case ProjectionMethod::kEwa:
        f = EwaFootprint<Lens, DualLane, Lane>(task.domain, dual_params, task.num_params, g);
        break;
      case ProjectionMethod::kSilhouette:
        f = SilhouetteFootprint<Lens, kOutlinePoints, Lane>(task.domain, params, task.num_params,
                                                            period, circle, g);
        break;
      default:
        f = SigmaFootprint<Lens, Lane>(task.domain, params, task.num_params, period, *task.rule, g);
        break;
    }
    StoreFootprints(f, possible, i, count, out);
  }
}

void FootprintRange(const FootprintTask& task, std::int64_t begin, std::int64_t end,
                    Footprints<float>* out) {
  switch (task.lens) {
#define GSUT_FOOTPRINT_CASE(Lens)                               \
  case LensModel::k##Lens:                                      \
    FootprintsOfLens<lane_lenses::Lens>(task, begin, end, out); \
    return;
    GSUT_FOR_EACH_LENS(GSUT_FOOTPRINT_CASE)
#undef GSUT_FOOTPRINT_CASE
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(FootprintRange);

void FootprintKernel(const FootprintTask& task, std::int64_t begin, std::int64_t end,
                     Footprints<float>* footprints) {
  HWY_DYNAMIC_DISPATCH(FootprintRange)(task, begin, end, footprints);
}

}  // namespace gsut
#endif
