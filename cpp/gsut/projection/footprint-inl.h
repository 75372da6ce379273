// Footprints of one Gaussian (or one a lane) by each method: its points, and its footprint from
// their pixels. Text for any scalar; the lens stands between the two.

#if defined(GSUT_PROJECTION_FOOTPRINT_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_PROJECTION_FOOTPRINT_INL_H_
#undef GSUT_PROJECTION_FOOTPRINT_INL_H_
#else
#define GSUT_PROJECTION_FOOTPRINT_INL_H_
#endif

#include <limits>

#include "gsut/projection/placed_gaussian.h"
#include "gsut/projection/footprint.h"
#include "gsut/projection/unscented-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Centre, covariance and bound.
template <class T>
struct BoundedFootprint : Footprint<T> {
  T low_u, high_u, low_v, high_v;
};

// reach: root of the cut-off of D^2, here and below.
template <class T>
HWY_INLINE void BoxFromCovariance(T reach, BoundedFootprint<T>* out) {
  const T half_u = reach * Sqrt(out->cov_uu);
  const T half_v = reach * Sqrt(out->cov_vv);
  out->low_u = out->u - half_u;
  out->high_u = out->u + half_u;
  out->low_v = out->v - half_v;
  out->high_v = out->v + half_v;
}

// The unscented transform's footprint from the pixels get(i, &u, &v) of its points, see
// UnscentedFootprint, with the box of its covariance.
template <class T, class Get>
HWY_INLINE BoundedFootprint<T> BoundUnscented(const LensDomain& domain,
                                              const UnscentedWeights& weights, T reach, Get&& get) {
  BoundedFootprint<T> out;
  static_cast<Footprint<T>&>(out) = UnscentedFootprint<T>(domain, weights, get);
  BoxFromCovariance(reach, &out);
  return out;
}

// Linear: the covariance through the lens' derivatives du, dv at the mean, whose pixel is (u, v).
// EWA (Zwicker et al., 2001): with J = dpixel_dpoint, cov = J R S S^T R^T J^T, summed axis by axis
// as the outer products of J (s_k q_k). Exact for a linear lens only.
template <class T>
HWY_INLINE BoundedFootprint<T> EwaFootprint(const PlacedGaussian<T>& g, T reach, T u, T v,
                                            const T* du, const T* dv) {
  BoundedFootprint<T> out;
  out.u = u;
  out.v = v;
  out.cov_uu = out.cov_uv = out.cov_vv = T(0.0);
  for (int k = 0; k < 3; ++k) {
    T along_u(0.0), along_v(0.0);
    for (int row = 0; row < 3; ++row) {
      const T step = g.scale[k] * g.axes[k][row];
      along_u = along_u + du[row] * step;
      along_v = along_v + dv[row] * step;
    }
    out.cov_uu = out.cov_uu + along_u * along_u;
    out.cov_uv = out.cov_uv + along_u * along_v;
    out.cov_vv = out.cov_vv + along_v * along_v;
  }
  BoxFromCovariance(reach, &out);
  return out;
}

// A closed outline of kPoints samples is resolved if its second differences stay below this share
// of its size (a circle of 16 points: 0.076); otherwise it may do anything between the samples.
inline constexpr double kResolved = 0.15;
// What the outline can do between two samples: an eighth of the second difference, and a fifth for
// the change of the second derivative between samples.
inline constexpr double kBetweenSamples = 1.2 / 8.0;

// The silhouette is exact: the points where the cone of rays from the camera touches the ellipsoid
// {D^2 = reach^2}, through the lens. It has an answer only where the outline bounds the footprint:
// the camera is outside the ellipsoid, the whole outline has pixels and is resolved, and no hole of
// the lens' domain (straight behind, or a panorama's pole) lies inside. Centre and covariance are
// those of the outline's first harmonic: of the ellipse in the limit of small Gaussians.
//
// In whitened coordinates the ellipsoid is a ball of radius k around w; the tangent points lie at
// w (1 - k^2/|w|^2) + k sqrt(1 - k^2/|w|^2) (cos, sin), and rays through them at
// w + k / sqrt(1 - k^2/|w|^2) (cos, sin).

// Calls put(i, x, y, z) for each point of the outline; false where there is no outline. circle:
// kPoints cosines and sines.
template <int kPoints, class T, class Put>
HWY_INLINE auto PutOutline(const LensDomain& domain, const double (*circle)[2],
                           const PlacedGaussian<T>& g, T reach, Put&& put) {
  const T one(1.0), zero(0.0);
  T w[3], back[3];
  T g2(0.0), back2(0.0), back_along(0.0);
  for (int k = 0; k < 3; ++k) {
    w[k] = (g.axes[k][0] * g.mean[0] + g.axes[k][1] * g.mean[1] + g.axes[k][2] * g.mean[2]) /
           g.scale[k];
    back[k] = -g.axes[k][2] / g.scale[k];
    g2 = g2 + w[k] * w[k];
    back2 = back2 + back[k] * back[k];
    back_along = back_along + w[k] * back[k];
  }
  const T cutoff = reach * reach;
  // The last part in a thousand is left to the exact search: the cone is nearly a half space.
  constexpr double kInside = 1.001;
  auto valid = g2 > T(kInside) * cutoff;
  if (!domain.IsPanorama() || domain.max_angle < kPi) {
    const auto holds_back =
        AndMask(back_along > zero, g2 - back_along * back_along / back2 < T(kInside) * cutoff);
    valid = AndMask(valid, Select(holds_back, zero, one) > zero);
  }
  const T sine2 = cutoff / g2;
  const T radius = reach / Sqrt(Select(valid, one - sine2, one));
  // Orthonormal e1, e2 across w without branches (Duff et al., JCGT 2017).
  const T inverse = one / Sqrt(g2);
  const T x = w[0] * inverse, y = w[1] * inverse, z = w[2] * inverse;
  const T sign = Select(z >= zero, one, -one);
  const T a = -one / (sign + z);
  const T b = x * y * a;
  const T e1[3] = {one + sign * x * x * a, sign * b, -sign * x};
  const T e2[3] = {b, sign + y * y * a, -y};
  T f1[3] = {zero, zero, zero}, f2[3] = {zero, zero, zero};
  for (int k = 0; k < 3; ++k) {
    for (int row = 0; row < 3; ++row) {
      f1[row] = f1[row] + radius * g.scale[k] * e1[k] * g.axes[k][row];
      f2[row] = f2[row] + radius * g.scale[k] * e2[k] * g.axes[k][row];
    }
  }
  for (int i = 0; i < kPoints; ++i) {
    const T c(circle[i][0]), s(circle[i][1]);
    put(i, g.mean[0] + c * f1[0] + s * f2[0], g.mean[1] + c * f1[1] + s * f2[1],
        g.mean[2] + c * f1[2] + s * f2[2]);
  }
  return valid;
}

// The footprint from the outline's pixels get(i, &u, &v), NaN where there is none. valid: whether
// there is an outline.
template <int kPoints, class T, class Get, class Mask>
HWY_INLINE BoundedFootprint<T> OutlineFootprint(const LensDomain& domain, const double (*circle)[2],
                                                T reach, Mask valid, Get&& get) {
  T u[kPoints], v[kPoints];
  T mean_u(0.0), mean_v(0.0), cos_u(0.0), cos_v(0.0), sin_u(0.0), sin_v(0.0);
  for (int i = 0; i < kPoints; ++i) {
    const T c(circle[i][0]), s(circle[i][1]);
    get(i, &u[i], &v[i]);
    if (i > 0) {
      u[i] = u[i - 1] + ShortWay(u[i] - u[i - 1], domain.period_u);
      v[i] = v[i - 1] + ShortWay(v[i] - v[i - 1], domain.period_v);
    }
    mean_u = mean_u + (u[i] - u[0]);
    mean_v = mean_v + (v[i] - v[0]);
    cos_u = cos_u + c * (u[i] - u[0]);
    sin_u = sin_u + s * (u[i] - u[0]);
    cos_v = cos_v + c * (v[i] - v[0]);
    sin_v = sin_v + s * (v[i] - v[0]);
  }
  BoundedFootprint<T> out;
  const auto range = [&](const T* value, double repeat, T* low, T* high) HWY_ATTR {
    T bend(0.0);
    *low = *high = value[0];
    for (int i = 0; i < kPoints; ++i) {
      const T before = value[i == 0 ? kPoints - 1 : i - 1];
      const T after = value[i == kPoints - 1 ? 0 : i + 1];
      bend = Max(bend, Abs(before + after - value[i] - value[i]));
      *low = Min(*low, value[i]);
      *high = Max(*high, value[i]);
    }
    valid = AndMask(valid, bend <= T(kResolved) * (*high - *low) + T(kBoxRounding));
    // Around a pole the outline does not close.
    if (repeat > 0.0) {
      valid = AndMask(valid, Abs(value[kPoints - 1] - value[0]) < T(0.5 * repeat));
    }
    *low = *low - T(kBetweenSamples) * bend;
    *high = *high + T(kBetweenSamples) * bend;
  };
  range(u, domain.period_u, &out.low_u, &out.high_u);
  range(v, domain.period_v, &out.low_v, &out.high_v);
  constexpr double kPart = 1.0 / kPoints;
  out.u = Select(valid, u[0] + T(kPart) * mean_u, T(std::numeric_limits<double>::quiet_NaN()));
  out.v = v[0] + T(kPart) * mean_v;
  const T factor = T(4.0 * kPart * kPart) / (reach * reach);
  out.cov_uu = factor * (cos_u * cos_u + sin_u * sin_u);
  out.cov_uv = factor * (cos_u * cos_v + sin_u * sin_v);
  out.cov_vv = factor * (cos_v * cos_v + sin_v * sin_v);
  return out;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
