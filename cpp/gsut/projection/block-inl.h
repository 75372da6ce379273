// Blocks of Gaussians on their way through a lens: what decides whether they can be seen, and the
// points that stand for them, small enough to stay in the first-level cache.

#if defined(GSUT_PROJECTION_BLOCK_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_PROJECTION_BLOCK_INL_H_
#undef GSUT_PROJECTION_BLOCK_INL_H_
#else
#define GSUT_PROJECTION_BLOCK_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/cameras/lens_kernels.h"
#include "gsut/projection/placed_gaussian.h"
#include "gsut/projection/seen-inl.h"

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

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
