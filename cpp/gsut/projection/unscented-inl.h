// The unscented transform of one Gaussian (or one a lane): its points, and its moments from their
// pixels. Text for any scalar; the lens stands between the two.

#if defined(GSUT_PROJECTION_UNSCENTED_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_PROJECTION_UNSCENTED_INL_H_
#undef GSUT_PROJECTION_UNSCENTED_INL_H_
#else
#define GSUT_PROJECTION_UNSCENTED_INL_H_
#endif

#include <hwy/highway.h>

#include "gsut/cameras/lens_domain.h"
#include "gsut/projection/project.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

inline constexpr int kUnscentedPoints = 7;

// Footprint of a Gaussian in pixels; u is NaN where it has none: a point of it has no pixel.
template <class T>
struct Footprint {
  T u, v, cov_uu, cov_uv, cov_vv;
};

// A difference of pixels, both inside one period (0: there is none), taken the short way round.
template <class T>
HWY_INLINE T ShortWay(T difference, double period) {
  if (!(period > 0.0)) return difference;
  const T whole(period), half(0.5 * period);
  const T lowered = Select(difference > half, difference - whole, difference);
  return Select(lowered < -half, lowered + whole, lowered);
}

// Calls put(i, x, y, z) for each sigma point: the mean, then two along each axis. mean[3],
// axes[k][3] and scale[3] in the frame of the points.
template <class T, class Put>
HWY_INLINE void PutUnscentedPoints(const UnscentedWeights& weights, const T* mean,
                                   const T (*axes)[3], const T* scale, Put&& put) {
  put(0, mean[0], mean[1], mean[2]);
  for (int k = 0; k < 3; ++k) {
    const T reach = T(weights.spread) * scale[k];
    const T step[3] = {axes[k][0] * reach, axes[k][1] * reach, axes[k][2] * reach};
    put(1 + 2 * k, mean[0] + step[0], mean[1] + step[1], mean[2] + step[2]);
    put(2 + 2 * k, mean[0] - step[0], mean[1] - step[1], mean[2] - step[2]);
  }
}

// The footprint from the pixels get(i, &u, &v) of these points, NaN where there is none.
// All differences are taken from the central point: with small alpha the weights are huge and
// cancel, and sums of the points themselves would lose their digits. Across the seam of a panorama
// they go the short way round; the centre may then lie beyond the seam.
template <class T, class Get>
HWY_INLINE Footprint<T> UnscentedFootprint(const LensDomain& domain,
                                           const UnscentedWeights& weights, Get&& get) {
  T u0, v0;
  get(0, &u0, &v0);
  T du[6], dv[6];
  T sum_u(0.0), sum_v(0.0);
  for (int i = 0; i < 6; ++i) {
    T u, v;
    get(1 + i, &u, &v);
    du[i] = u - u0;
    dv[i] = v - v0;
  }
  if (domain.IsPanorama()) {
    for (int i = 0; i < 6; ++i) {
      du[i] = ShortWay(du[i], domain.period_u);
      dv[i] = ShortWay(dv[i], domain.period_v);
    }
  }
  for (int i = 0; i < 6; ++i) {
    sum_u = sum_u + du[i];
    sum_v = sum_v + dv[i];
  }
  Footprint<T> out;
  const T shift_u = T(weights.mean_i) * sum_u;
  const T shift_v = T(weights.mean_i) * sum_v;
  out.u = u0 + shift_u;
  out.v = v0 + shift_v;
  out.cov_uu = T(weights.cov_0) * (shift_u * shift_u);
  out.cov_uv = T(weights.cov_0) * (shift_u * shift_v);
  out.cov_vv = T(weights.cov_0) * (shift_v * shift_v);
  for (int i = 0; i < 6; ++i) {
    const T eu = du[i] - shift_u;
    const T ev = dv[i] - shift_v;
    out.cov_uu = out.cov_uu + T(weights.mean_i) * (eu * eu);
    out.cov_uv = out.cov_uv + T(weights.mean_i) * (eu * ev);
    out.cov_vv = out.cov_vv + T(weights.mean_i) * (ev * ev);
  }
  return out;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
