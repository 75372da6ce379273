// The ray of every pixel of one image in one frame, however the camera moved while it was read out:
// what the renderers for moving cameras and lenses without one centre work on.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "gsut/cameras/camera.h"
#include "gsut/geometry/shutter.h"

namespace gsut {

// Rays in the frame of `reference`, the camera in the middle of the exposure: its axes, its centre
// as origin. Row-major, (height, width, 3).
struct ViewRays {
  int width = 0, height = 0;
  Pose reference;               // camera_from_world
  std::vector<double> rays;     // unit directions
  std::vector<double> origins;  // empty if all rays start at the reference's centre
  std::vector<std::uint8_t> valid;
  // All rays look along the camera's axis (Camera::IsParallel): then Gaussians are ordered by z and
  // shaded along the axis, else by their distance and direction from the reference's centre.
  bool is_parallel = false;

  bool HasOrigins() const { return !origins.empty(); }
};

// Gradients of a scalar to the rays' origins and directions, shaped like them, in the same frame.
// A direction counts as three free numbers.
struct RayGradients {
  std::vector<double> origins, rays;
};

// Gradients to what a Gaussian is shaded by, world axes: the reference's centre, or (parallel rays)
// its axis.
struct ShadingGradient {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();
};

// Throws InputError unless rays have a row a pixel, and gradients are shaped like them.
void CheckViewRays(const ViewRays& view);
void CheckRayGradients(const ViewRays& view, const Camera& camera, const RayGradients& gradients,
                       bool with_origins);

// Whether all rays of an image start at one point: then no ViewRays are needed.
bool HasOneCenter(const Camera& camera, const CameraMotion& motion);

// Each line is placed by its own pose. Pixels without a ray have NaN.
ViewRays MakeViewRays(const Camera& camera, const CameraMotion& motion);

// From the gradients to rays and shading to those of the poses: dpose[12], xi of start then of end;
// [6] for a global shutter. Added up in one order, whatever the number of threads.
void ChainToPoses(const ViewRays& view, const Camera& camera, const CameraMotion& motion,
                  const RayGradients& gradients, const ShadingGradient& shading, double* dpose);

}  // namespace gsut
