// The unscented transform through a camera that moves while it reads its image out, in double.
#pragma once

#include <cstdint>

#include "gsut/cameras/camera.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/geometry/shutter.h"
#include "gsut/projection/project.h"

namespace gsut {

// Each sigma point is placed by the pose of the line that sees it: a fixed point, sought by
// iteration from the middle of the exposure. Points beyond the first or last line take the pose of
// that end of the exposure. Writes means (N, 2), covariances (N, 2, 2), valid (N): all sigma points
// have a pixel, and converged (N): all of them settled on a line to 1e-9 of the exposure within 50
// steps. Where either is 0 the footprint is NaN, never a guess. The renderers bound Gaussians by
// the lines themselves and need no such footprint; with a fast turn a point may be seen by several
// lines, and this finds one of them.
void ProjectMoving(const GaussiansView<const double>& gaussians, const Camera& camera,
                   const CameraMotion& motion, const UnscentedOptions& options, double* means,
                   double* covariances, std::uint8_t* valid, std::uint8_t* converged);

}  // namespace gsut
