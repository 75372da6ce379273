// The unscented transform of one Gaussian (or one a lane) through one lens; text for any scalar.

#if defined(GSUT_PROJECTION_UNSCENTED_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_PROJECTION_UNSCENTED_INL_H_
#undef GSUT_PROJECTION_UNSCENTED_INL_H_
#else
#define GSUT_PROJECTION_UNSCENTED_INL_H_
#endif

#include <hwy/highway.h>

#include "gsut/cameras/contract.h"
#include "gsut/projection/project.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Footprint of a Gaussian in pixels.
template <class T, class Mask>
struct Footprint {
  T u, v, cov_uu, cov_uv, cov_vv;
  Mask all_valid;  // every sigma point has a pixel
  Mask any_valid;
};

// Pixels after which a panorama repeats along u and v; 0 where it does not.
struct ImagePeriod {
  double u = 0.0, v = 0.0;
};

template <class Lens>
ImagePeriod PeriodOf(const LensDomain& domain, const double* params) {
  ImagePeriod period;
  if constexpr (requires { Lens::Period(domain, params, &period.u, &period.v); }) {
    Lens::Period(domain, params, &period.u, &period.v);
  }
  return period;
}

// A difference of pixels, both inside one period, taken the short way round.
template <class T>
HWY_INLINE T ShortWay(T difference, double period) {
  const T whole(period), half(0.5 * period);
  const T lowered = Select(difference > half, difference - whole, difference);
  return Select(lowered < -half, lowered + whole, lowered);
}

// mean[3], axes[k][3] and scale[3] in the camera frame; params as Lens::Project takes them.
// All differences are taken from the central point: with small alpha the weights are huge and
// cancel, and sums of the points themselves would lose their digits. Across the seam of a panorama
// they go the short way round; the centre may then lie beyond the seam.
template <class Lens, class T, class P>
HWY_INLINE auto Unscented(const LensDomain& domain, const P* params, int num_params,
                          const ImagePeriod& period, const UnscentedWeights& weights, const T* mean,
                          const T (*axes)[3], const T* scale) {
  constexpr bool kIsPanorama = requires { Lens::Period(domain, nullptr, nullptr, nullptr); };
  T u0, v0;
  auto all_valid = Lens::Project(domain, params, num_params, mean[0], mean[1], mean[2], &u0, &v0);
  auto any_valid = all_valid;
  T du[6], dv[6];
  T sum_u(0.0), sum_v(0.0);
  for (int k = 0; k < 3; ++k) {
    const T reach = T(weights.spread) * scale[k];
    const T step[3] = {axes[k][0] * reach, axes[k][1] * reach, axes[k][2] * reach};
    for (int side = 0; side < 2; ++side) {
      const T sign(side == 0 ? 1.0 : -1.0);
      T u, v;
      const auto valid = Lens::Project(domain, params, num_params, mean[0] + sign * step[0],
                                       mean[1] + sign * step[1], mean[2] + sign * step[2], &u, &v);
      all_valid = AndMask(all_valid, valid);
      any_valid = OrMask(any_valid, valid);
      du[2 * k + side] = u - u0;
      dv[2 * k + side] = v - v0;
      if constexpr (kIsPanorama) {
        if (period.u > 0.0) du[2 * k + side] = ShortWay(du[2 * k + side], period.u);
        if (period.v > 0.0) dv[2 * k + side] = ShortWay(dv[2 * k + side], period.v);
      }
      sum_u = sum_u + du[2 * k + side];
      sum_v = sum_v + dv[2 * k + side];
    }
  }
  Footprint<T, decltype(all_valid)> out;
  out.all_valid = all_valid;
  out.any_valid = any_valid;
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
