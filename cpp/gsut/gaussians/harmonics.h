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

// The first (degree + 1)^2 basis values at the unit direction (x, y, z); others are not written.
template <class T>
inline void HarmonicsBasis(int degree, T x, T y, T z, T* basis) {
  basis[0] = T(kSh0);
  if (degree < 1) return;
  basis[1] = T(-kSh1) * y;
  basis[2] = T(kSh1) * z;
  basis[3] = T(-kSh1) * x;
  if (degree < 2) return;
  const T xx = x * x, yy = y * y, zz = z * z;
  basis[4] = T(kSh2Xy) * (x * y);
  basis[5] = T(-kSh2Xy) * (y * z);
  basis[6] = T(kSh2Zz) * (T(2) * zz - xx - yy);
  basis[7] = T(-kSh2Xy) * (x * z);
  basis[8] = T(kSh2Xx) * (xx - yy);
  if (degree < 3) return;
  basis[9] = T(-kSh3Xxx) * y * (T(3) * xx - yy);
  basis[10] = T(kSh3Xyz) * (x * y) * z;
  basis[11] = T(-kSh3Xzz) * y * (T(4) * zz - xx - yy);
  basis[12] = T(kSh3Zzz) * z * (T(2) * zz - T(3) * (xx + yy));
  basis[13] = T(-kSh3Xzz) * x * (T(4) * zz - xx - yy);
  basis[14] = T(kSh3Xxz) * z * (xx - yy);
  basis[15] = T(-kSh3Xxx) * x * (xx - T(3) * yy);
}

// Chain rule of HarmonicsBasis: dl_dbasis[(degree + 1)^2] to dl_ddirection[3] (overwritten), with
// x, y, z as free numbers. A caller whose direction is v / |v| projects: (I - d d^T) dl_dd / |v|.
template <class T>
inline void HarmonicsBasisGradient(int degree, T x, T y, T z, const T* dl_dbasis,
                                   T* dl_ddirection) {
  T gx = T(0), gy = T(0), gz = T(0);
  const T* g = dl_dbasis;
  if (degree >= 1) {
    gx = T(-kSh1) * g[3];
    gy = T(-kSh1) * g[1];
    gz = T(kSh1) * g[2];
  }
  if (degree >= 2) {
    const T g4 = T(kSh2Xy) * g[4], g5 = T(-kSh2Xy) * g[5], g6 = T(2 * kSh2Zz) * g[6];
    const T g7 = T(-kSh2Xy) * g[7], g8 = T(2 * kSh2Xx) * g[8];
    gx = gx + y * g4 - x * g6 + z * g7 + x * g8;
    gy = gy + x * g4 + z * g5 - y * g6 - y * g8;
    gz = gz + y * g5 + T(2) * z * g6 + x * g7;
  }
  if (degree >= 3) {
    const T xx = x * x, yy = y * y, zz = z * z;
    const T xy = x * y, yz = y * z, xz = x * z;
    const T g9 = T(-3 * kSh3Xxx) * g[9], g10 = T(kSh3Xyz) * g[10], g11 = T(-kSh3Xzz) * g[11];
    const T g12 = T(3 * kSh3Zzz) * g[12], g13 = T(-kSh3Xzz) * g[13], g14 = T(kSh3Xxz) * g[14];
    const T g15 = T(-3 * kSh3Xxx) * g[15];
    const T difference = xx - yy;
    gx = gx + T(2) * xy * g9 + yz * g10 - T(2) * xy * g11 - T(2) * xz * g12 +
         (T(4) * zz - T(3) * xx - yy) * g13 + T(2) * xz * g14 + difference * g15;
    gy = gy + difference * g9 + xz * g10 + (T(4) * zz - xx - T(3) * yy) * g11 - T(2) * yz * g12 -
         T(2) * xy * g13 - T(2) * yz * g14 - T(2) * xy * g15;
    gz = gz + xy * g10 + T(8) * yz * g11 + (T(2) * zz - xx - yy) * g12 + T(8) * xz * g13 +
         difference * g14;
  }
  dl_ddirection[0] = gx;
  dl_ddirection[1] = gy;
  dl_ddirection[2] = gz;
}

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
