// From stored parameters to what they mean: opacity, scale, rotation; with derivatives.
//
// T is float or double. Everything is a small inline function on plain pointers, so that the double
// reference and the float stages share one text.
#pragma once

#include <cmath>

namespace gsut {

// opacity = 1 / (1 + exp(-logit)), in [0, 1]; exact to rounding over the whole range of T.
template <class T>
inline T Sigmoid(T logit) {
  return T(1) / (T(1) + std::exp(-logit));
}

// doutput_dlogit, from the output itself.
template <class T>
inline T SigmoidDerivative(T opacity) {
  return opacity * (T(1) - opacity);
}

// The inverse of Sigmoid; opacity in (0, 1).
template <class T>
inline T Logit(T opacity) {
  return std::log(opacity) - std::log1p(-opacity);
}

// -ln(1 - Sigmoid(logit)): the optical depth of that opacity. Its derivative is Sigmoid(logit).
template <class T>
inline T Softplus(T logit) {
  return (logit > T(0) ? logit : T(0)) + std::log1p(std::exp(-std::abs(logit)));
}

// Standard deviation along one axis. Its derivative is the scale itself.
template <class T>
inline T ScaleFromLog(T log_scale) {
  return std::exp(log_scale);
}

// q / |q| into unit[4]; returns 1 / |q|. The largest component is divided out first, so that no
// norm over- or underflows. The zero quaternion, which has no direction, becomes the identity and
// returns 0, which makes its gradient 0. NaN stays NaN.
template <class T>
inline T NormalizeQuaternion(const T* quat, T* unit) {
  T largest = T(0);
  for (int i = 0; i < 4; ++i) {
    const T magnitude = std::abs(quat[i]);
    if (largest == largest && !(magnitude <= largest)) largest = magnitude;  // takes and keeps NaN
  }
  if (largest == T(0)) {
    unit[0] = T(1);
    unit[1] = unit[2] = unit[3] = T(0);
    return T(0);
  }
  T squares = T(0);
  for (int i = 0; i < 4; ++i) {
    unit[i] = quat[i] / largest;
    squares += unit[i] * unit[i];
  }
  const T inverse_norm = T(1) / std::sqrt(squares);
  for (int i = 0; i < 4; ++i) unit[i] *= inverse_norm;
  return inverse_norm / largest;
}

// World-from-Gaussian rotation of a quaternion w, x, y, z of any norm, row-major into rotation[9];
// its columns are the Gaussian's axes. The zero quaternion gives the identity.
template <class T>
inline void RotationFromQuaternion(const T* quat, T* rotation) {
  T unit[4];
  NormalizeQuaternion(quat, unit);
  const T w = unit[0], x = unit[1], y = unit[2], z = unit[3];
  rotation[0] = T(1) - T(2) * (y * y + z * z);
  rotation[1] = T(2) * (x * y - w * z);
  rotation[2] = T(2) * (x * z + w * y);
  rotation[3] = T(2) * (x * y + w * z);
  rotation[4] = T(1) - T(2) * (x * x + z * z);
  rotation[5] = T(2) * (y * z - w * x);
  rotation[6] = T(2) * (x * z - w * y);
  rotation[7] = T(2) * (y * z + w * x);
  rotation[8] = T(1) - T(2) * (x * x + y * y);
}

// Chain rule of RotationFromQuaternion: dl_drotation[9] to dl_dquat[4] (overwritten), including the
// normalisation, so that dl_dquat is orthogonal to quat.
template <class T>
inline void RotationFromQuaternionBackward(const T* quat, const T* dl_drotation, T* dl_dquat) {
  T unit[4];
  const T inverse_norm = NormalizeQuaternion(quat, unit);
  const T w = unit[0], x = unit[1], y = unit[2], z = unit[3];
  const T* g = dl_drotation;
  const T dl_dunit[4] = {
      T(2) * (x * (g[7] - g[5]) + y * (g[2] - g[6]) + z * (g[3] - g[1])),
      T(2) * (w * (g[7] - g[5]) + y * (g[1] + g[3]) + z * (g[2] + g[6]) - T(2) * x * (g[4] + g[8])),
      T(2) * (w * (g[2] - g[6]) + x * (g[1] + g[3]) + z * (g[5] + g[7]) - T(2) * y * (g[0] + g[8])),
      T(2) * (w * (g[3] - g[1]) + x * (g[2] + g[6]) + y * (g[5] + g[7]) - T(2) * z * (g[0] + g[4])),
  };
  const T along =
      unit[0] * dl_dunit[0] + unit[1] * dl_dunit[1] + unit[2] * dl_dunit[2] + unit[3] * dl_dunit[3];
  for (int i = 0; i < 4; ++i) dl_dquat[i] = (dl_dunit[i] - along * unit[i]) * inverse_norm;
}

}  // namespace gsut
