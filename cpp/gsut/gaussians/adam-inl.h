// Adam's arithmetic on consecutive elements, compiled once per instruction set.

#if defined(GSUT_GAUSSIANS_ADAM_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_GAUSSIANS_ADAM_INL_H_
#undef GSUT_GAUSSIANS_ADAM_INL_H_
#else
#define GSUT_GAUSSIANS_ADAM_INL_H_
#endif

#include <hwy/highway.h>

#include <cstddef>

#include "gsut/gaussians/harmonics_step.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using AdamTag = hn::ScalableTag<float>;

// m and v are running means of g and g^2; see adam.h for the equations and their source. Their bias
// corrections are constants of a step: that of m is in the rate, that of v under the root.
// One vector of elements; rate already holds the first moment's bias correction.
template <class D, class V = hn::Vec<D>>
HWY_INLINE void UpdateVector(D d, const AdamConstants& c, V rate, V gradient, V& param, V& moment1,
                             V& moment2) {
  moment1 = hn::Add(hn::Mul(hn::Set(d, c.beta1), moment1),
                    hn::Mul(hn::Set(d, c.one_minus_beta1), gradient));
  moment2 = hn::Add(hn::Mul(hn::Set(d, c.beta2), moment2),
                    hn::Mul(hn::Mul(hn::Set(d, c.one_minus_beta2), gradient), gradient));
  const V denominator = hn::Add(hn::Mul(hn::Sqrt(moment2), hn::Set(d, c.inverse_sqrt_correction2)),
                                hn::Set(d, c.epsilon));
  param = hn::Sub(param, hn::Div(hn::Mul(rate, moment1), denominator));
}

// Steps the elements [i, count), whole vectors of D first, then halves of it: nothing outside the
// range is read or written. rates: one value, or with kManyRates one an element.
template <bool kManyRates, class D>
HWY_INLINE void UpdateFrom(D d, std::size_t i, const AdamConstants& c, std::size_t count,
                           const float* rates, const float* gradients, float* params,
                           float* moment1, float* moment2) {
  constexpr std::size_t kStep = hn::MaxLanes(D());
  auto rate = hn::Set(d, rates[0]);
  for (; i + kStep <= count; i += kStep) {
    if (kManyRates) rate = hn::LoadU(d, rates + i);
    auto p = hn::LoadU(d, params + i);
    auto m = hn::LoadU(d, moment1 + i);
    auto v = hn::LoadU(d, moment2 + i);
    UpdateVector(d, c, rate, hn::LoadU(d, gradients + i), p, m, v);
    hn::StoreU(p, d, params + i);
    hn::StoreU(m, d, moment1 + i);
    hn::StoreU(v, d, moment2 + i);
  }
  if constexpr (kStep > 1) {
    if (i == count) return;
    UpdateFrom<kManyRates>(hn::FixedTag<float, kStep / 2>(), i, c, count, rates, gradients, params,
                           moment1, moment2);
  }
}

// Steps `count` consecutive elements.
template <bool kManyRates>
HWY_INLINE void UpdateRange(const AdamConstants& c, std::size_t count, const float* rates,
                            const float* gradients, float* params, float* moment1, float* moment2) {
  UpdateFrom<kManyRates>(AdamTag(), 0, c, count, rates, gradients, params, moment1, moment2);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
