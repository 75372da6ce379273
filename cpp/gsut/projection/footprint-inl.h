// Footprints of one Gaussian (or one a lane) through one lens by each method; text for any scalar.

#if defined(GSUT_PROJECTION_FOOTPRINT_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_PROJECTION_FOOTPRINT_INL_H_
#undef GSUT_PROJECTION_FOOTPRINT_INL_H_
#else
#define GSUT_PROJECTION_FOOTPRINT_INL_H_
#endif

#include "gsut/projection/sigma_rule.h"
#include "gsut/projection/unscented-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Centre, covariance and half size of the bound; `valid` where the method has an answer.
template <class T, class Mask>
struct PlacedFootprint {
  T u, v, cov_uu, cov_uv, cov_vv;
  T low_u, high_u, low_v, high_v;
  Mask valid;
};

// The Gaussian in the camera frame: mean, axes[k] (unit) with scale[k], and the root of the cut-off
// of D^2.
template <class T>
struct PlacedGaussian {
  T mean[3], axes[3][3], scale[3], reach;
};

template <class T, class Mask>
HWY_INLINE void BoxFromCovariance(T reach, PlacedFootprint<T, Mask>* out) {
  const T half_u = reach * Sqrt(out->cov_uu);
  const T half_v = reach * Sqrt(out->cov_vv);
  out->low_u = out->u - half_u;
  out->high_u = out->u + half_u;
  out->low_v = out->v - half_v;
  out->high_v = out->v + half_v;
}

// Whether the text is compiled for a lens whose image repeats.
template <class Lens>
inline constexpr bool kRepeats = requires(const LensDomain& d) {
  Lens::Period(d, nullptr, nullptr, nullptr);
};

template <class Lens, class T>
HWY_INLINE T PeriodicDifference(T difference, double period) {
  if constexpr (kRepeats<Lens>) {
    if (period > 0.0) return ShortWay(difference, period);
  }
  return difference;
}

// By a rule of points. Differences are taken from the first point, across a seam the short way.
template <class Lens, class T, class P>
HWY_INLINE auto SigmaFootprint(const LensDomain& domain, const P* params, int num_params,
                               const ImagePeriod& period, const SigmaRule& rule,
                               const PlacedGaussian<T>& g) {
  T du[SigmaRule::kMaxPoints], dv[SigmaRule::kMaxPoints];
  T u0(0.0), v0(0.0), sum_u(0.0), sum_v(0.0);
  auto valid = T(0.0) < T(1.0);
  for (int i = 0; i < rule.size; ++i) {
    T point[3] = {g.mean[0], g.mean[1], g.mean[2]};
    for (int k = 0; k < 3; ++k) {
      const T step = T(rule.points[i][k]) * g.scale[k];
      for (int row = 0; row < 3; ++row) point[row] = point[row] + step * g.axes[k][row];
    }
    T u, v;
    valid = AndMask(
        valid, Lens::Project(domain, params, num_params, point[0], point[1], point[2], &u, &v));
    if (i == 0) {
      u0 = u;
      v0 = v;
    }
    du[i] = PeriodicDifference<Lens>(u - u0, period.u);
    dv[i] = PeriodicDifference<Lens>(v - v0, period.v);
    sum_u = sum_u + T(rule.mean_weights[i]) * du[i];
    sum_v = sum_v + T(rule.mean_weights[i]) * dv[i];
  }
  PlacedFootprint<T, decltype(valid)> out;
  out.valid = valid;
  out.u = u0 + sum_u;
  out.v = v0 + sum_v;
  out.cov_uu = out.cov_uv = out.cov_vv = T(0.0);
  for (int i = 0; i < rule.size; ++i) {
    const T eu = du[i] - sum_u, ev = dv[i] - sum_v;
    const T weight(rule.cov_weights[i]);
    out.cov_uu = out.cov_uu + weight * (eu * eu);
    out.cov_uv = out.cov_uv + weight * (eu * ev);
    out.cov_vv = out.cov_vv + weight * (ev * ev);
  }
  BoxFromCovariance(g.reach, &out);
  return out;
}

// Linear: the covariance through the lens' Jacobian at the mean. D is a dual number over T with at
// least 3 directions; dual_params are its constants.
template <class Lens, class D, class T, class P>
HWY_INLINE auto EwaFootprint(const LensDomain& domain, const P* dual_params, int num_params,
                             const PlacedGaussian<T>& g) {
  D u, v;
  const auto valid = Lens::Project(domain, dual_params, num_params, D(g.mean[0], 0),
                                   D(g.mean[1], 1), D(g.mean[2], 2), &u, &v);
  PlacedFootprint<T, std::remove_cv_t<decltype(valid)>> out;
  out.valid = valid;
  out.u = u.value;
  out.v = v.value;
  out.cov_uu = out.cov_uv = out.cov_vv = T(0.0);
  for (int k = 0; k < 3; ++k) {
    T along_u(0.0), along_v(0.0);
    for (int row = 0; row < 3; ++row) {
      const T step = g.scale[k] * g.axes[k][row];
      along_u = along_u + u.grad[row] * step;
      along_v = along_v + v.grad[row] * step;
    }
    out.cov_uu = out.cov_uu + along_u * along_u;
    out.cov_uv = out.cov_uv + along_u * along_v;
    out.cov_vv = out.cov_vv + along_v * along_v;
  }
  BoxFromCovariance(g.reach, &out);
  return out;
}

// A closed outline of kPoints samples is resolved if its second differences stay below this share
// of its size (a circle of 16 points: 0.076); otherwise it may do anything between the samples.
inline constexpr double kResolved = 0.15;
// What the outline can do between two samples: an eighth of the second difference, and a fifth for
// the change of the second derivative between samples.
inline constexpr double kBetweenSamples = 1.2 / 8.0;

// Exact: the points where the cone of rays from the camera touches the ellipsoid {D^2 = reach^2},
// through the lens. `valid` only where the outline bounds the footprint: the camera is outside the
// ellipsoid, the whole outline has pixels and is resolved, and no hole of the lens' domain
// (straight behind, or a panorama's pole) lies inside. Centre and covariance are those of the
// outline's first harmonic: of the ellipse in the limit of small Gaussians.
//
// In whitened coordinates the ellipsoid is a ball of radius k around w; the tangent points lie at
// w (1 - k^2/|w|^2) + k sqrt(1 - k^2/|w|^2) (cos, sin), and rays through them at
// w + k / sqrt(1 - k^2/|w|^2) (cos, sin).
template <class Lens, int kPoints, class T, class P>
HWY_INLINE auto SilhouetteFootprint(const LensDomain& domain, const P* params, int num_params,
                                    const ImagePeriod& period, const double (*circle)[2],
                                    const PlacedGaussian<T>& g) {
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
  const T cutoff = g.reach * g.reach;
  // The last part in a thousand is left to the exact search: the cone is nearly a half space.
  constexpr double kInside = 1.001;
  auto valid = g2 > T(kInside) * cutoff;
  if (!kRepeats<Lens> || domain.max_angle < kPi) {
    const auto holds_back =
        AndMask(back_along > zero, g2 - back_along * back_along / back2 < T(kInside) * cutoff);
    valid = AndMask(valid, Select(holds_back, zero, one) > zero);
  }
  const T sine2 = cutoff / g2;
  const T radius = g.reach / Sqrt(Select(valid, one - sine2, one));
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
  T u[kPoints], v[kPoints];
  T mean_u(0.0), mean_v(0.0), cos_u(0.0), cos_v(0.0), sin_u(0.0), sin_v(0.0);
  for (int i = 0; i < kPoints; ++i) {
    const T c(circle[i][0]), s(circle[i][1]);
    valid =
        AndMask(valid, Lens::Project(domain, params, num_params, g.mean[0] + c * f1[0] + s * f2[0],
                                     g.mean[1] + c * f1[1] + s * f2[1],
                                     g.mean[2] + c * f1[2] + s * f2[2], &u[i], &v[i]));
    if (i > 0) {
      u[i] = u[i - 1] + PeriodicDifference<Lens>(u[i] - u[i - 1], period.u);
      v[i] = v[i - 1] + PeriodicDifference<Lens>(v[i] - v[i - 1], period.v);
    }
    mean_u = mean_u + (u[i] - u[0]);
    mean_v = mean_v + (v[i] - v[0]);
    cos_u = cos_u + c * (u[i] - u[0]);
    sin_u = sin_u + s * (u[i] - u[0]);
    cos_v = cos_v + c * (v[i] - v[0]);
    sin_v = sin_v + s * (v[i] - v[0]);
  }
  PlacedFootprint<T, decltype(valid)> out;
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
    if constexpr (kRepeats<Lens>) {
      if (repeat > 0.0) {
        valid = AndMask(valid, Abs(value[kPoints - 1] - value[0]) < T(0.5 * repeat));
      }
    }
    *low = *low - T(kBetweenSamples) * bend;
    *high = *high + T(kBetweenSamples) * bend;
  };
  range(u, period.u, &out.low_u, &out.high_u);
  range(v, period.v, &out.low_v, &out.high_v);
  out.valid = valid;
  constexpr double kPart = 1.0 / kPoints;
  out.u = u[0] + T(kPart) * mean_u;
  out.v = v[0] + T(kPart) * mean_v;
  const T factor = T(4.0 * kPart * kPart) / cutoff;
  out.cov_uu = factor * (cos_u * cos_u + sin_u * sin_u);
  out.cov_uv = factor * (cos_u * cos_v + sin_u * sin_v);
  out.cov_vv = factor * (cos_v * cos_v + sin_v * sin_v);
  return out;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
