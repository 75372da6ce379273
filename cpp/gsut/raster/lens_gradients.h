// From gradients to the rays of an image to those of the lens' parameters.
#pragma once

#include <vector>

#include "gsut/cameras/camera.h"
#include "gsut/geometry/shutter.h"
#include "gsut/raster/view_rays.h"

namespace gsut {

// Gradient to each parameter of the lens: the pixels stay where they are, their rays move (see
// RayJacobian). Pixels whose ray has no derivative add nothing. gradients: of the image of `view`,
// with origins only where `view` has them. Same bits on any number of threads.
std::vector<double> ChainToLens(const ViewRays& view, const Camera& camera,
                                const CameraMotion& motion, const RayGradients& gradients);

}  // namespace gsut
