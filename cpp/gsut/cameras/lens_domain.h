// What is known of a lens with its parameters beside its text: where it is valid, where it repeats.
#pragma once

#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include "gsut/cameras/lens_constants.h"

namespace gsut {

// The valid domain of one lens with its parameters: a cone about the axis, or what `edge` leaves of
// it.
struct LensDomain {
  double max_angle = 0.0;             // radians from the axis; the domain is angle < max_angle
  double max_radius = 0.0;            // largest distorted radius in the domain, in focal lengths
  std::array<double, 4> limits = {};  // further limits; each lens says what it keeps here
  // For lenses whose domain ends at another angle in each direction: squared radii in the lens'
  // plane, one a sector (families/star_edge.h). Null: a whole cone.
  std::shared_ptr<const std::vector<float>> edge;
  // Of panoramas: pixels after which the image repeats along u and v (0: never), and the axis of
  // the camera frame (0 x, 1 y, 2 z) along which the two directions lie around which pixels turn.
  double period_u = 0.0, period_v = 0.0;
  static constexpr int kNoPole = -1;
  int pole_axis = kNoPole;

  bool IsPanorama() const { return pole_axis != kNoPole; }

  // Moves a pixel by whole periods to its copy nearest to another, so that their difference is the
  // short way round.
  void MoveNear(const double* target, double* pixel) const {
    if (period_u > 0.0) pixel[0] -= period_u * std::round((pixel[0] - target[0]) / period_u);
    if (period_v > 0.0) pixel[1] -= period_v * std::round((pixel[1] - target[1]) / period_v);
  }
};

inline constexpr int kMaxExampleParams = 80;

// A real lens, as test material and as documentation of what parameters look like.
struct LensExample {
  const char* origin;  // which device, solved by whom
  int width, height;   // pixels
  int num_params;
  double params[kMaxExampleParams];
};

}  // namespace gsut
