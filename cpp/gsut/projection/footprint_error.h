// How far the linear and the unscented footprint may be from the truth: bounds by Taylor's formula.
#pragma once

#include <algorithm>
#include <cmath>

#include "gsut/projection/lens_bound.h"

namespace gsut {

// Bounds in pixels. With h a point's offset from the mean, relative to the mean's distance, the
// lens is f(m + h) = f(m) + Df h + r, |r| <= |D^2 f| |h|^2 / 2, and the next term is |D^3 f|
// |h|^3/6. The truth of a box is the footprint's own: of all rays on which alpha reaches the
// cut-off. The truth of a centre is the mean of the projected Gaussian cut off at kFullReach, which
// is what an opaque one shows: of the whole Gaussian there is no mean, since its tail reaches the
// camera.
struct FootprintError {
  double ewa;               // EWA's box edges, and its centre
  double unscented_center;  // the unscented centre
  double unscented_box;     // the unscented box edges
  double loosest_box;       // unscented_box beyond which the silhouette is taken anyway
};

inline constexpr double kFullReach = 3.3290430;            // sqrt(2 ln 255), standard deviations
inline constexpr double kSigmaReach = 1.7320508075688772;  // sqrt(3), of the points of alpha = 1

// An unscented box may be wider than it needs to be by this share of its half size.
inline constexpr double kLooseBox = 0.5;

// The sine that LensBend::At is asked for: of the cone around the cut-off ball, the sigma points
// and the ball of the centre. size: the largest standard deviation over the mean's distance; reach:
// root of the cut-off of D^2.
inline double BendSine(double size, double reach) { return size * std::max(reach, kFullReach); }

// Third absolute moment of a standard normal vector in 3D (cut off, it is smaller), and of its
// sigma points: 3^1.5; over 3!.
inline constexpr double kThirdMoments = (6.383 + 5.197) / 6.0;
// What cutting at kFullReach takes off each variance: 1 - P(chi2_5 < 11.08) / P(chi2_3 < 11.08);
// times 3 axes, over 2!.
inline constexpr double kCutMoments = 1.5 * 0.0389195;

// For the unscented transform of alpha 1, beta 2, kappa 0, whose weights are positive.
inline FootprintError BoundFootprintError(const Bend& bend, double size, double reach) {
  const double shrink = size / (1.0 - BendSine(size, reach));
  const double second = bend.second * shrink * shrink;
  FootprintError error;
  error.ewa = 0.5 * std::max(reach * reach, 3.0) * second;
  error.unscented_center =
      kCutMoments * second + kThirdMoments * bend.third * shrink * shrink * shrink;
  // Each sigma point strays by 3/2 `second` from the linear one, and so does their mean; the
  // standard deviation strays by the weighted norm of both: less than sqrt(3) times that.
  const double stray = 1.5 * second;
  error.unscented_box = error.ewa + (1.0 + kSigmaReach * reach) * stray;
  // No box is wider than the steepest direction of the lens makes it.
  error.loosest_box = kLooseBox * reach * size * bend.first;
  return error;
}

}  // namespace gsut
