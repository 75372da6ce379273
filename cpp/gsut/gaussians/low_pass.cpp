// The filter and its derivative, computed in double for either type.
#include "gsut/gaussians/low_pass.h"

#include <algorithm>
#include <cmath>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

constexpr std::int64_t kGrain = 4096;

// Per axis s' = sqrt(s^2 + r^2). A Gaussian seen along a random direction casts a shadow whose
// squared area is, in the mean, proportional to
//   A^2 = (s1 s2)^2 + (s2 s3)^2 + (s3 s1)^2,
// so the opacity's factor A(s) / A(s') keeps what it hides. All in logarithms, where nothing
// overflows:
//   d log A / d log s_k = s_k^2 (s_i^2 + s_j^2) / A^2   (share),
//   d log s' / d log s  = s^2 / s'^2                     (keep).

// One Gaussian's filter.
struct Filtered {
  double log_scale[3];
  double keep[3];       // s^2 / s'^2
  double share[3];      // d log A / d log s_k at the stored scales ...
  double share_out[3];  // ... and at the filtered ones
  double log_factor;    // log (A(s) / A(s'))
};

// d log A / d log s_k of log scales l, and log A; the largest scale is divided out.
double LogArea(const double* l, double* share) {
  const double largest = std::max({l[0], l[1], l[2]});
  double square[3];
  for (int k = 0; k < 3; ++k) square[k] = std::exp(2.0 * (l[k] - largest));
  const double sum = square[0] * square[1] + square[1] * square[2] + square[2] * square[0];
  for (int k = 0; k < 3; ++k) {
    share[k] = sum > 0.0 ? square[k] * (square[(k + 1) % 3] + square[(k + 2) % 3]) / sum : 0.0;
  }
  return 0.5 * std::log(sum) + 2.0 * largest;
}

template <class T>
Filtered Filter(const T* log_scales, double radius) {
  Filtered f;
  double l[3];
  const double log_radius = std::log(radius);
  for (int k = 0; k < 3; ++k) {
    l[k] = static_cast<double>(log_scales[k]);
    // log sqrt(s^2 + r^2) without overflow.
    const double high = std::max(l[k], log_radius), low = std::min(l[k], log_radius);
    f.log_scale[k] = high + 0.5 * std::log1p(std::exp(2.0 * (low - high)));
    f.keep[k] = std::exp(2.0 * (l[k] - f.log_scale[k]));
  }
  f.log_factor = LogArea(l, f.share) - LogArea(f.log_scale, f.share_out);
  // A needle without thickness has no shadow; it is not drawn.
  if (!(f.log_factor <= 0.0)) f.log_factor = std::isnan(f.log_factor) ? -INFINITY : 0.0;
  return f;
}

// 1 - p and the logit of p = c sigmoid(logit), c = exp(log_factor) <= 1.
void FilteredOpacity(double logit, double log_factor, double* rest, double* filtered) {
  const double opacity = 1.0 / (1.0 + std::exp(-logit)), clear = 1.0 / (1.0 + std::exp(logit));
  // 1 - p = (1 - o) - o (c - 1): no cancellation where the opacity is near one.
  *rest = clear - opacity * std::expm1(log_factor);
  *filtered = std::log(opacity) + log_factor - std::log(*rest);
}

}  // namespace

template <class T>
void ApplyLowPass(std::int64_t count, const T* log_scales, const T* opacity_logits, const T* radii,
                  T* out_log_scales, T* out_opacity_logits) {
  ParallelFor(count, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      if (!(radii[i] > T(0))) {
        std::copy_n(log_scales + 3 * i, 3, out_log_scales + 3 * i);
        out_opacity_logits[i] = opacity_logits[i];
        continue;
      }
      const Filtered f = Filter(log_scales + 3 * i, static_cast<double>(radii[i]));
      for (int k = 0; k < 3; ++k) out_log_scales[3 * i + k] = static_cast<T>(f.log_scale[k]);
      double rest, logit;
      FilteredOpacity(static_cast<double>(opacity_logits[i]), f.log_factor, &rest, &logit);
      out_opacity_logits[i] = static_cast<T>(logit);
    }
  });
}

template <class T>
void LowPassBackward(std::int64_t count, const T* log_scales, const T* opacity_logits,
                     const T* radii, T* dlog_scales, T* dopacity_logits) {
  ParallelFor(count, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      if (!(radii[i] > T(0))) continue;
      const Filtered f = Filter(log_scales + 3 * i, static_cast<double>(radii[i]));
      double rest, logit;
      FilteredOpacity(static_cast<double>(opacity_logits[i]), f.log_factor, &rest, &logit);
      const double clear = 1.0 / (1.0 + std::exp(static_cast<double>(opacity_logits[i])));
      const double slope = static_cast<double>(dopacity_logits[i]);
      // With p = c sigmoid(x): dlogit(p)/dx = (1 - sigmoid(x)) / (1 - p), dlogit(p)/dlog c = 1 /
      // (1 - p).
      dopacity_logits[i] = static_cast<T>(slope * clear / rest);
      for (int k = 0; k < 3; ++k) {
        const double through_opacity = (f.share[k] - f.share_out[k] * f.keep[k]) / rest;
        dlog_scales[3 * i + k] = static_cast<T>(
            static_cast<double>(dlog_scales[3 * i + k]) * f.keep[k] + slope * through_opacity);
      }
    }
  });
}

template void ApplyLowPass<float>(std::int64_t, const float*, const float*, const float*, float*,
                                  float*);
template void ApplyLowPass<double>(std::int64_t, const double*, const double*, const double*,
                                   double*, double*);
template void LowPassBackward<float>(std::int64_t, const float*, const float*, const float*, float*,
                                     float*);
template void LowPassBackward<double>(std::int64_t, const double*, const double*, const double*,
                                      double*, double*);

}  // namespace gsut
