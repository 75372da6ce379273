// Proven bounds of a lens' derivatives over a patch of directions.
#pragma once

#include "gsut/cameras/camera.h"
#include "gsut/projection/interval.h"

namespace gsut {

// With f(p) the pixel of the point p in the camera frame (constant along rays), at |p| = 1:
// first = the largest |Df(p)[h]| over unit h, second the largest |D^2 f(p)[h, h]|, third the
// largest |D^3 f(p)[h, h, h]|, in pixels, each for the worse of u and v; at other distances they
// fall as 1/|p|, 1/|p|^2 and 1/|p|^3. Infinite where they are not known to be bounded.
struct Bend {
  float first, second, third;
};

// The directions (1, x, y) of a face of a cube: +x, -x, +y, -y, +z, -z in turn, the other two
// coordinates in order.
void FacePoint(int face, double x, double y, double point[3]);

// Bend over all directions of the patch x, y of a face, by interval arithmetic through the lens'
// own text (enclosed.h). Infinite where the patch is not certainly inside the domain, where the
// lens has a kink, and through lenses whose rays do not meet, unless they are parallel: such an
// image is linear.
Bend BoundBend(const Camera& camera, int face, Interval x, Interval y);

}  // namespace gsut
