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
using AdamVec = hn::Vec<AdamTag>;

// One vector of elements; rate already holds the first moment's bias correction.
HWY_INLINE void UpdateVector(const AdamConstants& c, AdamVec rate, AdamVec gradient, AdamVec& param,
                             AdamVec& moment1, AdamVec& moment2) {
  const AdamTag d;
  moment1 = hn::Add(hn::Mul(hn::Set(d, c.beta1), moment1),
                    hn::Mul(hn::Set(d, c.one_minus_beta1), gradient));
  moment2 = hn::Add(hn::Mul(hn::Set(d, c.beta2), moment2),
                    hn::Mul(hn::Mul(hn::Set(d, c.one_minus_beta2), gradient), gradient));
  const AdamVec denominator = hn::Add(
      hn::Mul(hn::Sqrt(moment2), hn::Set(d, c.inverse_sqrt_correction2)), hn::Set(d, c.epsilon));
  param = hn::Sub(param, hn::Div(hn::Mul(rate, moment1), denominator));
}

// Steps `count` consecutive elements. rates: one value, or with kManyRates one an element.
template <bool kManyRates>
HWY_INLINE void UpdateRange(const AdamConstants& c, std::size_t count, const float* rates,
                            const float* gradients, float* params, float* moment1, float* moment2) {
  const AdamTag d;
  const std::size_t lanes = hn::Lanes(d);
  AdamVec rate = hn::Set(d, rates[0]);
  std::size_t i = 0;
  for (; i + lanes <= count; i += lanes) {
    if (kManyRates) rate = hn::LoadU(d, rates + i);
    AdamVec p = hn::LoadU(d, params + i);
    AdamVec m = hn::LoadU(d, moment1 + i);
    AdamVec v = hn::LoadU(d, moment2 + i);
    UpdateVector(c, rate, hn::LoadU(d, gradients + i), p, m, v);
    hn::StoreU(p, d, params + i);
    hn::StoreU(m, d, moment1 + i);
    hn::StoreU(v, d, moment2 + i);
  }
  if (i == count) return;
  // Nothing outside the range is read or written.
  const auto rest = hn::FirstN(d, count - i);
  if (kManyRates) rate = hn::MaskedLoad(rest, d, rates + i);
  AdamVec p = hn::MaskedLoad(rest, d, params + i);
  AdamVec m = hn::MaskedLoad(rest, d, moment1 + i);
  AdamVec v = hn::MaskedLoad(rest, d, moment2 + i);
  UpdateVector(c, rate, hn::MaskedLoad(rest, d, gradients + i), p, m, v);
  hn::BlendedStore(p, rest, d, params + i);
  hn::BlendedStore(m, rest, d, moment1 + i);
  hn::BlendedStore(v, rest, d, moment2 + i);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
