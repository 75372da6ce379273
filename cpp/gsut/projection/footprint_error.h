// How far the linear and the unscented footprint may be from the truth: bounds by Taylor's formula.
#pragma once

#include <algorithm>
#include <cmath>

#include "gsut/projection/lens_bend.h"

namespace gsut {

// Bounds in pixels. With h a point's offset from the mean, relative to the mean's distance, the
// lens is f(m + h) = f(m) + Df h + r, |r| <= |D^2 f| |h|^2 / 2.
struct FootprintError {
  double ewa;               // EWA's box edges, against the footprint's
  double unscented_center;  // the unscented centre, against the mean of the projected Gaussian
  double unscented_box;     // the unscented box edges, against the footprint's
};

// The sine that LensBend::At is asked for: of the cone around the cut-off ball and the sigma
// points. size: the largest standard deviation over the mean's distance; reach: root of the cut-off
// of D^2.
inline constexpr double kSigmaReach = 1.7320508075688772;  // sqrt(3), of the points of alpha = 1
inline double BendSine(double size, double reach) { return size * std::max(reach, kSigmaReach); }

// Third absolute moment of a standard normal vector in 3D, and of its sigma points: 3^1.5; over 3!.
inline constexpr double kThirdMoments = (6.383 + 5.197) / 6.0;

// For the unscented transform of alpha 1, beta 2, kappa 0, whose weights are positive.
inline FootprintError BoundFootprintError(const Bend& bend, double size, double reach) {
  const double shrink = 1.0 / (1.0 - BendSine(size, reach));
  const double second = bend.second * size * size * shrink * shrink;
  FootprintError error;
  error.ewa = 0.5 * std::max(reach * reach, 3.0) * second;
  error.unscented_center =
      kThirdMoments * bend.third * size * size * size * shrink * shrink * shrink;
  // Each sigma point strays by 3/2 `second` from the linear one, and so does their mean; the
  // standard deviation strays by the weighted norm of both: sqrt(1 + 2) times that.
  const double stray = 1.5 * second;
  error.unscented_box = error.ewa + (1.0 + kSigmaReach * reach) * stray;
  return error;
}

// An unscented box may be wider than it needs to be by this share of its half size; beyond, the
// silhouette is taken.
inline constexpr double kLooseBox = 0.5;

}  // namespace gsut
