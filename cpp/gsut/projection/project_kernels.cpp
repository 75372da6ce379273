// The vectorised projection, compiled once per instruction set and lens.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/projection/project_kernels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/base/lanes-inl.h"
#include "gsut/cameras/contract.h"
#include "gsut/cameras/lens_registry.h"
#include "gsut/projection/project_kernels.h"
#include "gsut/projection/seen-inl.h"
#include "gsut/projection/unscented-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace lane_lenses {
#include "gsut_lens_files.inc"
}  // namespace lane_lenses

// A Gaussian closer than this many times its own cut-off ellipsoid is left to the exact test: the
// footprint of what surrounds the camera is no ellipse.
inline constexpr double kNearFactor = 4.0;

// A splat is dropped before the exact test if its extents, times this factor and plus these pixels,
// miss the image.
inline constexpr double kCullFactor = 3.0;
inline constexpr double kCullPixels = 8.0;

// Whether an interval of pixels meets [0, size].
HWY_INLINE LaneMask Meets(Lane low, Lane high, Lane size) {
  return AndMask(high >= Lane(0.0), low <= size);
}

// A panorama's image repeats: the same, for the interval's copies one period to either side.
HWY_INLINE LaneMask CopyMeets(Lane low, Lane high, Lane size, double period) {
  const Lane shift(period);
  return OrMask(Meets(low + shift, high + shift, size), Meets(low - shift, high - shift, size));
}

template <class Lens>
void ProjectLens(const ProjectTask& task, std::int64_t begin, std::int64_t end, Splats* splats) {
  const FloatTag d;
  constexpr bool kHasTable = requires { Lens::kHasTable; };
  constexpr bool kIsPanorama = requires { Lens::Period(task.domain, nullptr, nullptr, nullptr); };
  Lane broadcast[kMaxLensParams];
  if constexpr (!kHasTable) {
    for (int i = 0; i < task.num_params; ++i) broadcast[i] = Lane(task.params[i]);
  }
  const auto* params = [&] {
    if constexpr (kHasTable) {
      return task.table;
    } else {
      return static_cast<const Lane*>(broadcast);
    }
  }();
  const ImagePeriod period = PeriodOf<Lens>(task.domain, task.params);
  const Lane width(task.width), height(task.height);
  for (std::int64_t i = begin; i < end; i += kLanes) {
    const SeenLanes g =
        LoadSeen(task.gaussians, i, task.view, task.log2_alpha_min, task.max_cutoff);
    const auto footprint = Unscented<Lens, Lane>(task.domain, params, task.num_params, period,
                                                 task.weights, g.mean, g.axes, g.scale);
    const Lane reach = Sqrt(Max(g.cutoff, Lane(0.0)));
    const Lane extent_u = reach * Sqrt(footprint.cov_uu);
    const Lane extent_v = reach * Sqrt(footprint.cov_vv);

    // Whole numbers of whitened distance: g2 = squared Mahalanobis distance of the camera.
    Lane g2(0.0);
    for (int k = 0; k < 3; ++k) {
      const Lane whitened = Dot3(g.axes[k], g.mean) / g.scale[k];
      g2 += whitened * whitened;
    }
    const LaneMask finite =
        AndMask(IsFinite(g2), IsFinite(g.mean[0] + g.mean[1] + g.mean[2] + g.distance));
    const LaneMask is_near = g2 <= Lane(kNearFactor) * g.cutoff;
    // The cone around the bounding sphere: outside the lens' domain, no pixel can see it. A sphere
    // around the camera has no cone.
    const Lane largest = Max(g.scale[0], Max(g.scale[1], g.scale[2]));
    Lane sine = Min(reach * largest / g.distance, Lane(1.0));
    const Lane mean_angle = Atan2(Sqrt(g.mean[0] * g.mean[0] + g.mean[1] * g.mean[1]), g.mean[2]);
    const Lane angle = mean_angle - Asin(sine);
    constexpr double kAngleSlack = 1e-5;  // float rounding of the angle
    const LaneMask outside_domain = AndMask(AndMask(NotMask(is_near), sine < Lane(1.0)),
                                            angle > Lane(task.domain.max_angle + kAngleSlack));
    const LaneMask whole =
        AndMask(AndMask(footprint.all_valid, NotMask(is_near)),
                IsFinite(footprint.u + footprint.v + footprint.cov_uu + footprint.cov_vv));
    // The ellipse is an estimate: only what lies well outside the image by it is dropped here.
    const Lane margin_u = Lane(kCullFactor) * extent_u + Lane(kCullPixels);
    const Lane margin_v = Lane(kCullFactor) * extent_v + Lane(kCullPixels);
    const Lane low_u = footprint.u - margin_u, high_u = footprint.u + margin_u;
    const Lane low_v = footprint.v - margin_v, high_v = footprint.v + margin_v;
    const LaneMask in_image = AndMask(Meets(low_u, high_u, width), Meets(low_v, high_v, height));
    const LaneMask candidate = AndMask(AndMask(g.usable, finite), NotMask(outside_domain));
    // Wide footprints bend: they too go to the exact test.
    const LaneMask wide = OrMask(extent_u > Lane(task.wide), extent_v > Lane(task.wide));
    LaneMask ellipse = AndMask(AndMask(candidate, whole), AndMask(in_image, NotMask(wide)));
    LaneMask uncertain = AndMask(candidate, OrMask(NotMask(whole), wide));
    // How far (sine or radians, at most 1) the lens is smooth around the Gaussian: its scale may
    // change without bound towards the edge of the domain, and a panorama turns around its poles.
    constexpr double kLeastSmooth = 1e-6;
    Lane smooth = Lane(task.domain.max_angle) - mean_angle;
    if constexpr (kIsPanorama) {
      // No ellipse: what crosses the seam, and what is not small beside its distance from a pole.
      smooth = Lens::PoleSine(g.mean[0], g.mean[1], g.mean[2]);
      constexpr double kNearPole = 0.5;
      LaneMask bent = sine > Lane(kNearPole) * smooth;
      if (period.u > 0.0) bent = OrMask(bent, CopyMeets(low_u, high_u, width, period.u));
      if (period.v > 0.0) bent = OrMask(bent, CopyMeets(low_v, high_v, height, period.v));
      ellipse = AndMask(ellipse, NotMask(bent));
      uncertain = OrMask(uncertain, AndMask(candidate, bent));
    }
    sine = Min(sine / Max(Min(smooth, Lane(1.0)), Lane(kLeastSmooth)), Lane(1.0));

    const auto store = [&](Lane value, AlignedVector<float>* array) HWY_ATTR {
      hn::StoreU(value.v, d, &(*array)[static_cast<std::size_t>(i)]);
    };
    store(footprint.u, &splats->u);
    store(footprint.v, &splats->v);
    store(footprint.cov_uu, &splats->cov_uu);
    store(footprint.cov_uv, &splats->cov_uv);
    store(footprint.cov_vv, &splats->cov_vv);
    store(extent_u, &splats->extent_u);
    store(extent_v, &splats->extent_v);
    store(g.distance, &splats->distance);
    store(sine, &splats->sine);
    LaneMask small = AndMask(ellipse, sine < Lane(kSmallSine));
    if constexpr (!kIsPanorama) {
      small = AndMask(small, mean_angle + sine < Lane(kSmallAngle * task.domain.max_angle));
    }
    const std::uint64_t is_small = MaskBits(small.m);
    const std::uint64_t is_ellipse = MaskBits(ellipse.m);
    const std::uint64_t is_uncertain = MaskBits(uncertain.m);
    const std::uint64_t has_pixels = MaskBits(footprint.all_valid.m);
    const int count = static_cast<int>(HWY_MIN(end - i, static_cast<std::int64_t>(kLanes)));
    for (int k = 0; k < count; ++k) {
      const std::size_t j = static_cast<std::size_t>(i + k);
      splats->status[j] = (is_small >> k) & 1       ? SplatStatus::kSmall
                          : (is_ellipse >> k) & 1   ? SplatStatus::kEllipse
                          : (is_uncertain >> k) & 1 ? SplatStatus::kUncertain
                                                    : SplatStatus::kUnseen;
      if (!((has_pixels >> k) & 1)) {
        for (AlignedVector<float>* array :
             {&splats->u, &splats->v, &splats->cov_uu, &splats->cov_uv, &splats->cov_vv,
              &splats->extent_u, &splats->extent_v}) {
          (*array)[j] = __builtin_nanf("");
        }
      }
    }
  }
}

void ProjectRange(const ProjectTask& task, std::int64_t begin, std::int64_t end, Splats* splats) {
  switch (task.lens) {
#define GSUT_PROJECT_CASE(Lens)                               \
  case LensModel::k##Lens:                                    \
    ProjectLens<lane_lenses::Lens>(task, begin, end, splats); \
    return;
    GSUT_FOR_EACH_LENS(GSUT_PROJECT_CASE)
#undef GSUT_PROJECT_CASE
  }
}

int LanesOfTarget() { return kLanes; }

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(ProjectRange);
HWY_EXPORT(LanesOfTarget);

void ProjectKernel(const ProjectTask& task, std::int64_t begin, std::int64_t end, Splats* splats) {
  HWY_DYNAMIC_DISPATCH(ProjectRange)(task, begin, end, splats);
}

int ActiveLanes() { return HWY_DYNAMIC_DISPATCH(LanesOfTarget)(); }

}  // namespace gsut
#endif
