// View-dependent colour: real spherical harmonics to degree 3, in the order and signs of 3DGS.
//
// Coefficient l^2 + l + m holds degree l, order m = -l .. l, with the Condon-Shortley phase kept
// (the sign (-1)^m of the usual real harmonics). The basis is written as homogeneous polynomials of
// the direction, which must be a unit vector for it to be orthonormal. Source: Sloan, "Efficient
// spherical harmonic evaluation", JCGT 2013, appendix A2.
#pragma once

#include "gsut/gaussians/gaussians.h"

namespace gsut {

// Added to the sum, so that zero coefficients are mid-grey (3DGS).
inline constexpr double kShColorOffset = 0.5;

// Normalisation factors of the polynomials below.
inline constexpr double kSh0 = 0.28209479177387814;    // sqrt(1 / pi) / 2
inline constexpr double kSh1 = 0.4886025119029199;     // sqrt(3 / pi) / 2
inline constexpr double kSh2Xy = 1.0925484305920792;   // sqrt(15 / pi) / 2
inline constexpr double kSh2Zz = 0.31539156525252005;  // sqrt(5 / pi) / 4
inline constexpr double kSh2Xx = 0.5462742152960396;   // sqrt(15 / pi) / 4
inline constexpr double kSh3Xxx = 0.5900435899266435;  // sqrt(35 / (2 pi)) / 4
inline constexpr double kSh3Xyz = 2.890611442640554;   // sqrt(105 / pi) / 2
inline constexpr double kSh3Xzz = 0.4570457994644658;  // sqrt(21 / (2 pi)) / 4
inline constexpr double kSh3Zzz = 0.3731763325901154;  // sqrt(7 / pi) / 4
inline constexpr double kSh3Xxz = 1.445305721320277;   // sqrt(105 / pi) / 4

constexpr int NumShCoefficients(int degree) { return (degree + 1) * (degree + 1); }

// The degree that has this many coefficients; -1 if none of 0 to 3 has.
constexpr int ShDegree(std::int64_t num_coefficients) {
  for (int degree = 0; degree <= kMaxShDegree; ++degree) {
    if (NumShCoefficients(degree) == num_coefficients) return degree;
  }
  return -1;
}

#include "gsut/gaussians/harmonics_basis.inc"

// color[3] = max(0, 0.5 + sum over k of basis_k(direction) sh[k][channel]) for a unit direction
// from the camera centre to the Gaussian. sh: (K, 3) with K >= (degree + 1)^2. Returns which
// channels were clamped, as bits 1 (red), 2 (green), 4 (blue); their gradient is 0. A NaN stays
// NaN.
template <class T>
inline unsigned EvalHarmonics(int degree, const T* direction, const T* sh, T* color) {
  T basis[kMaxShCoefficients];
  HarmonicsBasis(degree, direction[0], direction[1], direction[2], basis);
  const int coefficients = NumShCoefficients(degree);
  unsigned clamped = 0;
  for (int channel = 0; channel < 3; ++channel) {
    T sum = T(kShColorOffset);
    for (int k = 0; k < coefficients; ++k) sum += basis[k] * sh[3 * k + channel];
    if (sum < T(0)) {
      sum = T(0);
      clamped |= 1u << channel;
    }
    color[channel] = sum;
  }
  return clamped;
}

// Chain rule of EvalHarmonics. clamped: what the forward call returned. dl_dsh: the first
// (degree + 1)^2 rows of (K, 3) are overwritten; dl_ddirection[3] is overwritten (free x, y, z, as
// in HarmonicsBasisGradient).
template <class T>
inline void EvalHarmonicsBackward(int degree, const T* direction, const T* sh, unsigned clamped,
                                  const T* dl_dcolor, T* dl_dsh, T* dl_ddirection) {
  T basis[kMaxShCoefficients];
  HarmonicsBasis(degree, direction[0], direction[1], direction[2], basis);
  T g[3];
  for (int channel = 0; channel < 3; ++channel) {
    g[channel] = (clamped >> channel & 1u) != 0 ? T(0) : dl_dcolor[channel];
  }
  T dl_dbasis[kMaxShCoefficients];
  const int coefficients = NumShCoefficients(degree);
  for (int k = 0; k < coefficients; ++k) {
    dl_dbasis[k] = g[0] * sh[3 * k] + g[1] * sh[3 * k + 1] + g[2] * sh[3 * k + 2];
    for (int channel = 0; channel < 3; ++channel) dl_dsh[3 * k + channel] = basis[k] * g[channel];
  }
  HarmonicsBasisGradient(degree, direction[0], direction[1], direction[2], dl_dbasis,
                         dl_ddirection);
}

}  // namespace gsut
