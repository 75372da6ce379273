// A triangle as the lines of a tile see it: where they meet its plane.
//
// In the frame (D, E1, E2) of a bundle of lines a E1 + b E2 + x (D + s E1 + t E2), let m be the
// mean, n the unit normal and X, Y the other two axes over their scales. As in pair-inl.h, a line
// is at -(A E1 + B E2) from the mean in the plane x = m.D, and with d = (1, s, t) meets n's plane
// after
//   xi = (n_1 A + n_2 B) / (n.d),  at  (xi X.d - X_1 A - X_2 B, the same of Y)
// in units of the scales. X and Y are divided by the gauge's cut-off k, so that a triangle is drawn
// where the gauge is below 1. Its response is 1 - gauge k / r (gaussians/primitive.h).

#if defined(GSUT_RASTER_LINES_FLAT_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_FLAT_INL_H_
#undef GSUT_RASTER_LINES_FLAT_INL_H_
#else
#define GSUT_RASTER_LINES_FLAT_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/raster/lines/gaussian_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// What a triangle is in the frame of a bundle.
struct FlatPair {
  Lane m[3];        // mean along E1, E2, D
  Lane x[3], y[3];  // X and Y over k, n: along D, E1, E2
  Lane n[3];
  Lane end;  // k / r
};

// axes[3 k + j]: component j of D, E1, E2.
HWY_INLINE FlatPair PlaceFlat(const GaussianLanes& g, const Lane* axes) {
  FlatPair p;
  const Lane thickness = Sqrt(g.variance[2]);
  for (int k = 0; k < 3; ++k) {
    const Lane* axis = axes + 3 * k;
    p.m[(k + 2) % 3] = Dot3(g.mean, axis);
    p.x[k] = Dot3(g.whiten[0], axis) * g.inverse_k;
    p.y[k] = Dot3(g.whiten[1], axis) * g.inverse_k;
    p.n[k] = Dot3(g.whiten[2], axis) * thickness;
  }
  p.end = g.k * Lane(1.0 / triangle::kRadius);
  return p;
}

// As MayHit, for a triangle: whether a line within the bounds may lie inside all of its edges. With
// an edge's form W of X and Y and c = n x W, a line meets the plane where W is
//   c.((A, B) x d) / (n.d),  (A, B) x d = (A t - B s, B, -A):
// it lies outside where that is 1 or more. A box that has lines along the plane is taken for a hit.
HWY_INLINE LaneMask MayHitFlat(const FlatPair& p, const Lane* center, const Lane* half) {
  constexpr double kRounding = 1e-6;
  constexpr double kRelative = 1.0 + 1e-5;
  const Lane slack = Lane(kRounding) * (Abs(p.m[0]) + Abs(p.m[1]) + Abs(p.m[2]));
  const Lane s = center[2], t = center[3], depth = p.m[2];
  const Lane alpha = p.m[0] - center[0], beta = p.m[1] - center[1];
  const Lane a = alpha - depth * s, b = beta - depth * t;
  const Lane half_a = half[0] + slack, half_b = half[1] + slack;
  const Lane along = p.n[0] + p.n[1] * s + p.n[2] * t;
  const Lane half_along = Abs(p.n[1]) * half[2] + Abs(p.n[2]) * half[3];
  const Lane side = Select(along < Lane(0.0), Lane(-1.0), Lane(1.0));
  LaneMask outside = Lane(1.0) < Lane(0.0);
  for (const auto& edge : triangle::kEdges) {
    Lane w[3];
    for (int k = 0; k < 3; ++k) w[k] = Lane(edge[0]) * p.x[k] + Lane(edge[1]) * p.y[k];
    const Lane c[3] = {p.n[1] * w[2] - p.n[2] * w[1], p.n[2] * w[0] - p.n[0] * w[2],
                       p.n[0] * w[1] - p.n[1] * w[0]};
    const Lane beyond = side * (c[0] * (a * t - b * s) + c[1] * b - c[2] * a - along);
    const Lane spread = Abs(c[0] * t - c[2]) * half_a + Abs(c[1] - c[0] * s) * half_b +
                        Abs(depth * c[2] - c[0] * beta - p.n[1]) * half[2] +
                        Abs(c[0] * alpha - depth * c[1] - p.n[2]) * half[3] +
                        Abs(c[0]) * (half_a * half[3] + half_b * half[2]);
    outside = OrMask(outside, beyond >= spread * Lane(kRelative));
  }
  return NotMask(AndMask(outside, Abs(along) > half_along * Lane(kRelative)));
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
