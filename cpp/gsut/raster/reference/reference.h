// The truth: a scalar double renderer without tiles, every Gaussian at every pixel, and its exact
// backward. Slow by design; every kernel is tested against it.
#pragma once

#include <cstdint>
#include <vector>

#include "gsut/cameras/camera.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/geometry/shutter.h"
#include "gsut/raster/blend_rule.h"
#include "gsut/raster/task.h"
#include "gsut/raster/view_rays.h"

namespace gsut {

// Row-major buffers of height * width pixels. A pixel without a ray stays 0 in all of them.
struct ReferenceImage {
  std::vector<double> image;  // (H, W, 3)
  std::vector<double> alpha;  // (H, W): 1 - final transmittance
  std::vector<double> depth;  // (H, W): sum of weight times distance along the ray
  // (H, W): sum of weight times the squared distance from the mean, see kDistortionAlpha
  std::vector<double> distortion;
  std::vector<int> samples;      // (H, W): Gaussians blended
  std::vector<double> channels;  // (H, W, D), of the channels
};

// chosen (H, W): only pixels that are not 0 are rendered, the others stay 0; null: all. Throws
// InputError if a parameter is not finite.
ReferenceImage RenderReference(const GaussiansView<const double>& gaussians, const ViewRays& view,
                               const RenderSettings& settings, const std::uint8_t* chosen = nullptr,
                               const Channels<double>& channels = {});

// The same through a lens, each line of the image from its own pose.
ReferenceImage RenderReference(const GaussiansView<const double>& gaussians, const Camera& camera,
                               const CameraMotion& motion, const RenderSettings& settings,
                               const std::uint8_t* chosen = nullptr,
                               const Channels<double>& channels = {});

// Pixel gradients, row-major; all but the first may be null.
struct ReferenceGradients {
  const double* image;                 // (H, W, 3)
  const double* alpha = nullptr;       // (H, W)
  const double* depth = nullptr;       // (H, W)
  const double* distortion = nullptr;  // (H, W)
  // Of channels: what was rendered, the gradient to its image (H, W, D), and where the gradient to
  // its values (N, D) goes.
  Channels<double> channels = {};
  const double* channel_image = nullptr;
  double* to_channels = nullptr;
};

// Gradients of L = sum(dimage * image) + sum(dalpha * alpha) + sum(ddepth * depth) +
// sum(ddistortion * distortion). Writes (does not add) all of `gradients`, shaped like the
// Gaussians, and the gradients to rays and shading. The cut-offs of the blend rule are not
// differentiated; a clamped alpha or colour has gradient 0. chosen: as above; L sums over these
// pixels only.
void RenderReferenceBackward(const GaussiansView<const double>& gaussians, const ViewRays& view,
                             const RenderSettings& settings, const ReferenceGradients& to_image,
                             const GaussiansView<double>& gradients, RayGradients* rays,
                             ShadingGradient* shading, const std::uint8_t* chosen = nullptr);

// The same, with dpose[12] in place of the shading's: the gradients to xi = (v, w) in
// camera_from_world <- ExpPose(xi) camera_from_world of the start pose, then of the end pose; [6]
// for a global shutter. rays: as above, in the frame of MakeViewRays' reference; may be null.
void RenderReferenceBackward(const GaussiansView<const double>& gaussians, const Camera& camera,
                             const CameraMotion& motion, const RenderSettings& settings,
                             const ReferenceGradients& to_image,
                             const GaussiansView<double>& gradients, double* dpose,
                             RayGradients* rays = nullptr, const std::uint8_t* chosen = nullptr);

}  // namespace gsut
