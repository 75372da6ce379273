// MCMC regularisers, compiled once per instruction set.
#include "gsut/optimize/mcmc.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/optimize/mcmc_regularizer.cpp"
#include "gsut/base/hwy_targets.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef GSUT_OPTIMIZE_MCMC_REGULARIZER_ONCE
#define GSUT_OPTIMIZE_MCMC_REGULARIZER_ONCE
#include <algorithm>

#include "gsut/base/parallel.h"
#endif  // GSUT_OPTIMIZE_MCMC_REGULARIZER_ONCE

#include "gsut/base/lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

// sums[i] += map(values[i]) of i in [begin, end), a vector at a time.
template <class Map>
HWY_INLINE void AddMapped(const float* values, float* sums, std::int64_t begin, std::int64_t end,
                          const Map& map) {
  const FloatTag d;
  std::int64_t i = begin;
  for (; i + kLanes <= end; i += kLanes) {
    const Lane more = map(Lane(hn::LoadU(d, values + i)));
    hn::StoreU(hn::Add(hn::LoadU(d, sums + i), more.v), d, sums + i);
  }
  if (i == end) return;
  HWY_ALIGN float rest[kLanes] = {};
  std::copy(values + i, values + end, rest);
  hn::Store(map(Lane(hn::Load(d, rest))).v, d, rest);
  for (std::int64_t k = 0; i + k < end; ++k) sums[i + k] += rest[k];
}

// Highway's Exp is garbage beyond 104: a larger exponent is taken as this one, the end of float.
HWY_INLINE Lane ExpWithin(Lane x) {
  constexpr double kLargestExponent = 88.5;  // its exponential is 2.7e38, still a float
  const Lane largest(kLargestExponent);
  return Exp(Select(x > largest, largest, x));
}

}  // namespace

// The loss  w_o mean(sigmoid(logit)) + w_s mean(exp(log_scale))  makes Gaussians transparent and
// small that photographs do not hold against it. Its derivatives:
//   by logit      w_o / N      o (1 - o),
//   by log_scale  w_s / (3 N)  exp(log_scale).
void Regularize(const GaussiansView<const float>& params, std::int64_t begin, std::int64_t end,
                float opacity_factor, float scale_factor, float* dl_dopacity_logits,
                float* dl_dlog_scales) {
  AddMapped(params.opacity_logits, dl_dopacity_logits, begin, end, [&](Lane logit) HWY_ATTR {
    const Lane opacity = Lane(1.0) / (Lane(1.0) + ExpWithin(-logit));
    return Lane(opacity_factor) * (opacity * (Lane(1.0) - opacity));
  });
  AddMapped(params.log_scales, dl_dlog_scales, 3 * begin, 3 * end,
            [&](Lane log_scale) HWY_ATTR { return Lane(scale_factor) * ExpWithin(log_scale); });
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {

HWY_EXPORT(Regularize);

void AddMcmcRegularizer(const GaussiansView<const float>& params, std::int64_t size,
                        double opacity_weight, double scale_weight, float* dl_dopacity_logits,
                        float* dl_dlog_scales) {
  constexpr std::int64_t kChunkRows = 1024;
  const double count = static_cast<double>(std::max<std::int64_t>(size, 1));
  const auto opacity_factor = static_cast<float>(opacity_weight / count);
  const auto scale_factor = static_cast<float>(scale_weight / (3.0 * count));
  const auto regularize = HWY_DYNAMIC_DISPATCH(Regularize);
  ParallelFor(size, kChunkRows, [&](std::int64_t begin, std::int64_t end) {
    regularize(params, begin, end, opacity_factor, scale_factor, dl_dopacity_logits,
               dl_dlog_scales);
  });
}

}  // namespace gsut
#endif  // HWY_ONCE
