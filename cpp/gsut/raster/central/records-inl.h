// Makes the 16-float record of each Gaussian for one camera, and its colour from the harmonics.

#if defined(GSUT_RASTER_CENTRAL_RECORDS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CENTRAL_RECORDS_INL_H_
#undef GSUT_RASTER_CENTRAL_RECORDS_INL_H_
#else
#define GSUT_RASTER_CENTRAL_RECORDS_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/projection/seen-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Everything of a record but the colour. `visible` is the mask of lanes that can be drawn.
struct RecordLanes {
  Lane a[3], b[3], c[3], k, kappa;
  LaneMask visible;
};

// Below this fraction of 1 / g^2 the scale s is clamped: the camera is inside the Gaussian's
// cut-off ellipsoid, every ray with z > 0 hits, and the test N < z^2 passes to within 1e-5 rad of z
// = 0.
inline constexpr double kInsideScale = 0x1p-34;

HWY_INLINE RecordLanes MakeRecord(const SeenLanes& g) {
  RecordLanes out;
  // Whitened mean, g in the notation of frame.h.
  Lane inverse_scale[3], whitened[3];
  for (int k = 0; k < 3; ++k) {
    inverse_scale[k] = Lane(1.0) / g.scale[k];
    whitened[k] = Dot3(g.axes[k], g.mean) * inverse_scale[k];
  }
  const Lane g2 = Dot3(whitened, whitened);
  const Lane inverse_g2 = Lane(1.0) / g2;
  const Lane dist2 = g.distance * g.distance;
  const Lane inverse_dist = Lane(1.0) / g.distance;
  const Lane ux = g.mean[0] * inverse_dist;
  const Lane uy = g.mean[1] * inverse_dist;
  const Lane uz = g.mean[2] * inverse_dist;
  // Orthonormal e1, e2 with u x e1 = e2, without branches (Duff et al., JCGT 2017).
  const Lane sign = Select(uz >= Lane(0.0), Lane(1.0), Lane(-1.0));
  const Lane aa = Lane(-1.0) / (sign + uz);
  const Lane bb = ux * uy * aa;
  const Lane e1[3] = {Lane(1.0) + sign * ux * ux * aa, sign * bb, -sign * ux};
  const Lane e2[3] = {bb, sign + uy * uy * aa, -uy};
  // |g x A d| = |S Q^T (m x d)| / det S: no difference of large numbers, even for needles.
  const Lane factor = dist2 / Sqrt(g2);
  const Lane weight[3] = {factor * inverse_scale[1] * inverse_scale[2],
                          factor * inverse_scale[0] * inverse_scale[2],
                          factor * inverse_scale[0] * inverse_scale[1]};
  Lane k1[3], k2[3];
  for (int k = 0; k < 3; ++k) {
    k1[k] = weight[k] * Dot3(g.axes[k], e2);
    k2[k] = -(weight[k] * Dot3(g.axes[k], e1));
  }
  // One-sided Jacobi rotation of (k1, k2).
  const Lane n11 = Dot3(k1, k1);
  const Lane n22 = Dot3(k2, k2);
  const Lane n12 = Dot3(k1, k2);
  const Lane twice = n12 + n12;
  const Lane zeta = (n22 - n11) / Select(Abs(twice) > Lane(0.0), twice, Lane(1e-30));
  const Lane tangent = Select(zeta >= Lane(0.0), Lane(1.0), Lane(-1.0)) /
                       (Abs(zeta) + Sqrt(MulAdd(zeta, zeta, Lane(1.0))));
  const Lane cosine = Lane(1.0) / Sqrt(MulAdd(tangent, tangent, Lane(1.0)));
  const Lane sine = cosine * tangent;
  Lane p1[3], p2[3];
  for (int k = 0; k < 3; ++k) {
    p1[k] = cosine * k1[k] - sine * k2[k];
    p2[k] = sine * k1[k] + cosine * k2[k];
  }
  const Lane n1 = Sqrt(Dot3(p1, p1));
  const Lane n2 = Sqrt(Dot3(p2, p2));
  // The product of the singular values is known in closed form: the small one keeps its digits.
  const Lane product =
      dist2 * g.distance / Sqrt(g2) * inverse_scale[0] * inverse_scale[1] * inverse_scale[2];
  const LaneMask first_is_large = n1 >= n2;
  const Lane sigma1 = Select(first_is_large, n1, product / n2);
  const Lane sigma2 = Select(first_is_large, product / n1, n2);

  const Lane s = Max(Lane(1.0) / g.cutoff - inverse_g2, Lane(kInsideScale) * inverse_g2);
  const Lane root_s = Sqrt(s);
  const Lane scale_a = root_s * sigma1;
  const Lane scale_b = root_s * sigma2;
  const Lane scale_c = g.distance * inverse_g2;
  Lane sum(0.0);
  for (int k = 0; k < 3; ++k) {
    out.a[k] = scale_a * (cosine * e1[k] - sine * e2[k]);
    out.b[k] = scale_b * (sine * e1[k] + cosine * e2[k]);
    out.c[k] = scale_c * (g.axes[0][k] * (whitened[0] * inverse_scale[0]) +
                          g.axes[1][k] * (whitened[1] * inverse_scale[1]) +
                          g.axes[2][k] * (whitened[2] * inverse_scale[2]));
    sum += Abs(out.a[k]) + Abs(out.b[k]) + Abs(out.c[k]);
  }
  out.k = inverse_g2 / s;
  constexpr double kHalfLog2E = 0.72134752044448170368;
  out.kappa = Lane(-kHalfLog2E) / s;
  out.visible = AndMask(g.usable, IsFinite(sum + out.k - out.kappa));
  return out;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
