// Refines poses, and optionally the lens, from the colours of photographs of a known scene.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "gsut/cameras/camera.h"
#include "gsut/geometry/pose.h"

namespace gsut {

// What a scene looks like: given by whoever can render it.
class SceneColors {
 public:
  virtual ~SceneColors() = default;
  // Colours (count, 3) of an image's pixels (row-major indices). by_center and by_ray (count, 3, 3)
  // are both null or both wanted: colour by the camera's centre (world axes) and by the pixel's
  // unit ray (across it, camera axes).
  virtual void Evaluate(const Camera& camera, const Pose& camera_from_world,
                        std::span<const std::uint32_t> pixels, double* colors, double* by_center,
                        double* by_ray) = 0;
};

// A photograph, by some of its pixels. It is compared with gain x colour of the scene + bias.
struct PhotometricImage {
  int camera = 0;
  Pose camera_from_world;
  double gain = 1.0, bias = 0.0;
  std::vector<std::uint32_t> pixels;
  std::vector<float> colors;  // (pixels, 3)
};

struct PhotometricRefinementOptions {
  double loss_scale = 0.1;  // colour difference beyond which a pixel counts less (Huber); 0: never
  int max_iterations = 20;  // steps that lower the cost
  double function_tolerance = 1e-5;  // relative decrease of the cost at which it stops
  bool with_gain = true;             // estimate gain and bias of each image
  // lens_free[c]: which parameters of camera c are estimated, one flag each; empty: none.
  std::vector<std::vector<std::uint8_t>> lens_free;
};

struct PhotometricSummary {
  double rms_before = 0.0, rms_after = 0.0;  // colour differences of a channel, no loss
  int iterations = 0, evaluations = 0;
  bool converged = false;
};

// Levenberg-Marquardt by Ceres over all images at once, the scene fixed; changes cameras and images
// in place. A step that leaves a pixel without a ray, or that makes the parameters no lens, is
// refused. Throws InputError for an index out of range or an image without pixels, SolveError with
// the solver's message if it fails.
PhotometricSummary RefinePhotometric(SceneColors* scene, std::vector<Camera>* cameras,
                                     std::vector<PhotometricImage>* images,
                                     const PhotometricRefinementOptions& options);

}  // namespace gsut
