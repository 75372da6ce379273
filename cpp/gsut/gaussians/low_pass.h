// A 3D low-pass filter: no Gaussian is thinner than the pixels that see it; with its derivative.
#pragma once

#include <cstdint>

namespace gsut {

// Gaussian i is convolved with a round one of standard deviation radius[i]: scales s become
// s' = sqrt(s^2 + radius^2). So that the light that passes stays the same, opacities are multiplied
// by A(s) / A(s'), A^2 = (s1 s2)^2 + (s2 s3)^2 + (s3 s1)^2: up to a constant the mean, over all
// directions, of the squared area of the shadow. (Mip-Splatting, Yu et al. 2024, takes the ratio of
// volumes instead, which makes thin discs vanish that are seen from the front.)
//
// Reads log_scales (count, 3), opacity_logits (count), radii (count, >= 0); writes the filtered
// ones. T: float or double. radius 0 changes nothing.
template <class T>
void ApplyLowPass(std::int64_t count, const T* log_scales, const T* opacity_logits, const T* radii,
                  T* out_log_scales, T* out_opacity_logits);

// Turns gradients to the filtered log_scales and opacity_logits into those to the stored ones, in
// place; radii are constants.
template <class T>
void LowPassBackward(std::int64_t count, const T* log_scales, const T* opacity_logits,
                     const T* radii, T* dlog_scales, T* dopacity_logits);

extern template void ApplyLowPass<float>(std::int64_t, const float*, const float*, const float*,
                                         float*, float*);
extern template void ApplyLowPass<double>(std::int64_t, const double*, const double*, const double*,
                                          double*, double*);
extern template void LowPassBackward<float>(std::int64_t, const float*, const float*, const float*,
                                            float*, float*);
extern template void LowPassBackward<double>(std::int64_t, const double*, const double*,
                                             const double*, double*, double*);

}  // namespace gsut
