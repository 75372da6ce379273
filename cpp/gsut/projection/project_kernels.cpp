// The vectorised projection, compiled once per instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/projection/project_kernels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/base/lanes-inl.h"
#include "gsut/cameras/lens_kernels.h"
#include "gsut/projection/project_kernels.h"
#include "gsut/projection/seen-inl.h"
#include "gsut/projection/unscented-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Points and pixels, one vector after the other.
struct PointBlock {
  static constexpr int kPoints = 1024;  // 20 kB
  alignas(64) float x[kPoints], y[kPoints], z[kPoints], u[kPoints], v[kPoints];

  LensBatch Batch() { return {x, y, z, u, v}; }

  HWY_INLINE void Put(int vector, Lane px, Lane py, Lane pz) {
    const FloatTag d;
    hn::Store(px.v, d, x + vector * kLanes);
    hn::Store(py.v, d, y + vector * kLanes);
    hn::Store(pz.v, d, z + vector * kLanes);
  }
  HWY_INLINE void Get(int vector, Lane* pu, Lane* pv) const {
    const FloatTag d;
    pu->v = hn::Load(d, u + vector * kLanes);
    pv->v = hn::Load(d, v + vector * kLanes);
  }
};

// Whether a Gaussian can be seen, judged by its place and size alone.
struct Visibility {
  Lane g2;                 // squared Mahalanobis distance of the camera
  Lane reach;              // root of the cut-off of D^2
  Lane sine;               // of the half angle of the cone around the cut-off sphere; at most 1
  Lane mean_angle;         // of the mean from the axis
  LaneMask possible;       // can be drawn, and all of its numbers are finite
  LaneMask beyond_domain;  // the cone lies outside the lens' domain: no pixel can see it
};

// In whitened coordinates the camera lies at distance g from the mean, g^2 = sum of (q_k . m /
// s_k)^2. The cut-off ellipsoid lies in the sphere of radius reach x largest scale, seen within
// asin(radius / distance) of the mean's direction.
HWY_INLINE Visibility VisibilityOf(const SeenLanes& g, double max_angle) {
  Visibility out;
  out.g2 = Lane(0.0);
  for (int k = 0; k < 3; ++k) {
    const Lane whitened = Dot3(g.axes[k], g.mean) / g.scale[k];
    out.g2 += whitened * whitened;
  }
  out.possible =
      AndMask(g.usable,
              AndMask(IsFinite(out.g2), IsFinite(g.mean[0] + g.mean[1] + g.mean[2] + g.distance)));
  out.reach = Sqrt(Max(g.cutoff, Lane(0.0)));
  const Lane largest = Max(g.scale[0], Max(g.scale[1], g.scale[2]));
  out.sine = Min(out.reach * largest / g.distance, Lane(1.0));
  out.mean_angle = Atan2(Sqrt(g.mean[0] * g.mean[0] + g.mean[1] * g.mean[1]), g.mean[2]);
  constexpr double kAngleSlack = 1e-5;  // float rounding of the angle
  // A sphere around the camera has no cone.
  out.beyond_domain =
      AndMask(out.sine<Lane(1.0), out.mean_angle - Asin(out.sine)> Lane(max_angle + kAngleSlack));
  return out;
}

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

// Sine of the angle between the mean and the nearer pole of a panorama.
HWY_INLINE Lane PoleSine(const LensDomain& domain, const Lane* mean) {
  const Lane up = mean[domain.pole_axis];
  const Lane across = mean[domain.pole_axis == 0 ? 1 : 0];
  const Lane ahead = mean[domain.pole_axis == 2 ? 1 : 2];
  const Lane level_square = across * across + ahead * ahead;
  return Sqrt(level_square / (level_square + up * up));
}

// What is kept of a Gaussian while its points go through the lens.
struct WaitingSplat {
  Lane reach, sine, mean_angle;
  Lane smooth;  // how far (sine or radians) the lens is smooth around it
  LaneMask candidate, is_near;
};

HWY_INLINE WaitingSplat PutSplat(const ProjectTask& task, std::int64_t i, int first_vector,
                                 PointBlock* block, Splats* splats) {
  const LensDomain& domain = task.lens.domain;
  const SeenLanes g = LoadSeen(task.gaussians, i, task.view, task.log2_raw_min, task.max_cutoff);
  PutUnscentedPoints(task.weights, g.mean, g.axes, g.scale,
                     [&](int k, Lane x, Lane y, Lane z)
                         HWY_ATTR { block->Put(first_vector + k, x, y, z); });
  const Visibility seen = VisibilityOf(g, domain.max_angle);
  WaitingSplat out;
  out.reach = seen.reach;
  out.sine = seen.sine;
  out.mean_angle = seen.mean_angle;
  out.is_near = seen.g2 <= Lane(kNearFactor) * g.cutoff;
  out.candidate =
      AndMask(seen.possible, NotMask(AndMask(NotMask(out.is_near), seen.beyond_domain)));
  // The lens' scale may change without bound towards the edge of its domain, and a panorama turns
  // around its poles.
  out.smooth =
      domain.IsPanorama() ? PoleSine(domain, g.mean) : Lane(domain.max_angle) - seen.mean_angle;
  hn::StoreU(g.distance.v, FloatTag(), &splats->distance[static_cast<std::size_t>(i)]);
  return out;
}

// count: how many lanes hold a Gaussian.
// What the ellipse is worth: kSmall, it bounds the footprint; kEllipse, it is a guess where to
// look; kUncertain, it says nothing (near the camera, wide, bent over a seam or a pole); kUnseen.
// Only what lies well outside by its ellipse is dropped here; all others are tested exactly by the
// raster.
HWY_INLINE void StoreSplat(const ProjectTask& task, const WaitingSplat& g,
                           const Footprint<Lane>& footprint, std::int64_t i, int count,
                           Splats* splats) {
  const LensDomain& domain = task.lens.domain;
  const Lane width(task.width), height(task.height);
  const Lane extent_u = g.reach * Sqrt(footprint.cov_uu);
  const Lane extent_v = g.reach * Sqrt(footprint.cov_vv);
  const LaneMask whole = AndMask(NotMask(g.is_near), IsFinite(footprint.u + footprint.v +
                                                              footprint.cov_uu + footprint.cov_vv));
  // The ellipse is an estimate: only what lies well outside the image by it is dropped here.
  const Lane margin_u = Lane(kCullFactor) * extent_u + Lane(kCullPixels);
  const Lane margin_v = Lane(kCullFactor) * extent_v + Lane(kCullPixels);
  const Lane low_u = footprint.u - margin_u, high_u = footprint.u + margin_u;
  const Lane low_v = footprint.v - margin_v, high_v = footprint.v + margin_v;
  const LaneMask in_image = AndMask(Meets(low_u, high_u, width), Meets(low_v, high_v, height));
  // Wide footprints bend: they too go to the exact test.
  const LaneMask wide = OrMask(extent_u > Lane(task.wide), extent_v > Lane(task.wide));
  LaneMask ellipse = AndMask(AndMask(g.candidate, whole), AndMask(in_image, NotMask(wide)));
  LaneMask uncertain = AndMask(g.candidate, OrMask(NotMask(whole), wide));
  if (domain.IsPanorama()) {
    // No ellipse: what crosses the seam, and what is not small beside its distance from a pole.
    constexpr double kNearPole = 0.5;
    LaneMask bent = g.sine > Lane(kNearPole) * g.smooth;
    if (domain.period_u > 0.0) {
      bent = OrMask(bent, CopyMeets(low_u, high_u, width, domain.period_u));
    }
    if (domain.period_v > 0.0) {
      bent = OrMask(bent, CopyMeets(low_v, high_v, height, domain.period_v));
    }
    ellipse = AndMask(ellipse, NotMask(bent));
    uncertain = OrMask(uncertain, AndMask(g.candidate, bent));
  }
  // How much the lens bends over the footprint: its half angle over how far the lens stays smooth.
  constexpr double kLeastSmooth = 1e-6;
  const Lane sine = Min(g.sine / Max(Min(g.smooth, Lane(1.0)), Lane(kLeastSmooth)), Lane(1.0));
  LaneMask small = AndMask(ellipse, sine < Lane(kSmallSine));
  if (!domain.IsPanorama()) {
    small = AndMask(small, g.mean_angle + sine < Lane(kSmallAngle * domain.max_angle));
  }

  const FloatTag d;
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
  store(sine, &splats->sine);
  const std::uint64_t is_small = MaskBits(small.m);
  const std::uint64_t is_ellipse = MaskBits(ellipse.m);
  const std::uint64_t is_uncertain = MaskBits(uncertain.m);
  for (int k = 0; k < count; ++k) {
    splats->status[static_cast<std::size_t>(i + k)] =
        (is_small >> k) & 1       ? SplatStatus::kSmall
        : (is_ellipse >> k) & 1   ? SplatStatus::kEllipse
        : (is_uncertain >> k) & 1 ? SplatStatus::kUncertain
                                  : SplatStatus::kUnseen;
  }
}

// Seven points a Gaussian, in blocks that stay in the first-level cache: placed, through the lens,
// and back to ellipses.
void ProjectRange(const ProjectTask& task, std::int64_t begin, std::int64_t end, Splats* splats) {
  constexpr int kVectors = PointBlock::kPoints / (kUnscentedPoints * kLanes);
  PointBlock block;
  WaitingSplat waiting[kVectors];
  for (std::int64_t first = begin; first < end; first += kVectors * kLanes) {
    int vectors = 0;
    for (std::int64_t i = first; i < end && vectors < kVectors; i += kLanes, ++vectors) {
      waiting[vectors] = PutSplat(task, i, kUnscentedPoints * vectors, &block, splats);
    }
    ProjectPoints(task.lens, kUnscentedPoints * kLanes * vectors, block.Batch());
    for (int v = 0; v < vectors; ++v) {
      const auto footprint = UnscentedFootprint<Lane>(
          task.lens.domain, task.weights,
          [&](int k, Lane* pu, Lane* pv) HWY_ATTR { block.Get(kUnscentedPoints * v + k, pu, pv); });
      const std::int64_t i = first + v * kLanes;
      const int count = static_cast<int>(HWY_MIN(end - i, static_cast<std::int64_t>(kLanes)));
      StoreSplat(task, waiting[v], footprint, i, count, splats);
    }
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
