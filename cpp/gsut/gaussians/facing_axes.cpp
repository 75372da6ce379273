// Paints each Gaussian with its normal, so that rendering colours renders normals.
//
// A Gaussian's shortest axis, turned to the camera, is written as the harmonic of degree 0 whose
// colour 0.5 + c0 sh is 0.5 (1 + n). Scalar: a few operations a Gaussian beside the hundreds of its
// pixels.
#include "gsut/gaussians/facing_axes.h"

#include <algorithm>
#include <cmath>

#include "gsut/base/parallel.h"
#include "gsut/gaussians/activations.h"

namespace gsut {
namespace {

// Gaussians of a chunk of parallel work: some tens of microseconds.
constexpr std::int64_t kGrain = 2048;
// Half a colour's range over the harmonic of degree 0: axes of -1 to 1 become colours of 0 to 1.
constexpr double kColorOfAxis = 0.5 / 0.28209479177387814;

// The axis across the disc that a flat Gaussian is; of equal scales the first.
template <class T>
int Shortest(const GaussiansView<const T>& g, std::int64_t i) {
  const T* scales = g.log_scales + 3 * i;
  return static_cast<int>(std::min_element(scales, scales + 3) - scales);
}

// The rotation's columns are the axes. Returns the factor of the harmonics.
template <class T>
double Facing(const GaussiansView<const T>& g, std::int64_t i, const double* center, int axis,
              double* quat, double* rotation) {
  for (int k = 0; k < 4; ++k) quat[k] = static_cast<double>(g.quats[4 * i + k]);
  RotationFromQuaternion(quat, rotation);
  double along = 0.0;
  for (int k = 0; k < 3; ++k) {
    along += rotation[3 * k + axis] * (static_cast<double>(g.means[3 * i + k]) - center[k]);
  }
  return along > 0.0 ? -kColorOfAxis : kColorOfAxis;
}

}  // namespace

template <class T>
void FacingAxes(const GaussiansView<const T>& g, const double* center, T* sh) {
  ParallelFor(g.size, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      double quat[4], rotation[9];
      const int axis = Shortest(g, i);
      const double factor = Facing(g, i, center, axis, quat, rotation);
      for (int k = 0; k < 3; ++k) {
        sh[3 * i + k] = static_cast<T>(factor * rotation[3 * k + axis]);
      }
    }
  });
}

// With n = s R e_k, s the sign that faces the camera and k the shortest axis, dL/dR has the one
// column s dL/dn, which the rotation's derivative carries to the quaternion as stored, not to a
// unit one.
template <class T>
void FacingAxesBackward(const GaussiansView<const T>& g, const double* center, const T* dsh,
                        T* dquats) {
  ParallelFor(g.size, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      if (dsh[3 * i] == T(0) && dsh[3 * i + 1] == T(0) && dsh[3 * i + 2] == T(0)) continue;
      // Only the shortest axis' column has a gradient; its sign and choice count as constants.
      double quat[4], rotation[9], to_rotation[9] = {}, to_quat[4];
      const int axis = Shortest(g, i);
      const double factor = Facing(g, i, center, axis, quat, rotation);
      for (int k = 0; k < 3; ++k) {
        to_rotation[3 * k + axis] = factor * static_cast<double>(dsh[3 * i + k]);
      }
      RotationFromQuaternionBackward(quat, to_rotation, to_quat);
      for (int k = 0; k < 4; ++k) dquats[4 * i + k] += static_cast<T>(to_quat[k]);
    }
  });
}

// Of L = weight / N sum over i of min_k exp(l_ik): each Gaussian's own shortest axis shrinks, and
// the others have no gradient.
template <class T>
void FlattenGradient(const GaussiansView<const T>& g, double weight, T* dlog_scales) {
  if (g.size == 0) return;
  const double each = weight / static_cast<double>(g.size);
  ParallelFor(g.size, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      // d exp(l) / dl = exp(l): the loss is the mean of the shortest scales.
      const std::int64_t at = 3 * i + Shortest(g, i);
      dlog_scales[at] += static_cast<T>(each * std::exp(static_cast<double>(g.log_scales[at])));
    }
  });
}

template void FacingAxes(const GaussiansView<const float>&, const double*, float*);
template void FacingAxes(const GaussiansView<const double>&, const double*, double*);
template void FacingAxesBackward(const GaussiansView<const float>&, const double*, const float*,
                                 float*);
template void FacingAxesBackward(const GaussiansView<const double>&, const double*, const double*,
                                 double*);
template void FlattenGradient(const GaussiansView<const float>&, double, float*);
template void FlattenGradient(const GaussiansView<const double>&, double, double*);

}  // namespace gsut
