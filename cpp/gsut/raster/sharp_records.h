// Records of Gaussians so thin that single precision would see them beside their place.
//
// In a tile's frame a.D is a difference of products of the size of |a|, known to eps |a| only.
// Where |a| or |b| exceeds kSharpForm, the direction n of the mean is kept to twice the digits of a
// float, and a.D is taken as a.(D - n), which is the same, as a.n = b.n = 0; likewise c.D = 1 +
// c.(D - n).
#pragma once

namespace gsut {

inline constexpr float kSharpForm = 256.0f;

// A direction: rounded to float, 0, what rounding took, 0.
inline constexpr int kDirectionSize = 8;

inline void SplitDirection(const double* direction, float* out) {
  for (int k = 0; k < 3; ++k) {
    out[k] = static_cast<float>(direction[k]);
    out[4 + k] = static_cast<float>(direction[k] - static_cast<double>(out[k]));
  }
  out[3] = out[7] = 0.0f;
}

}  // namespace gsut
