// Renders an image for photometric refinement and takes out the pixels asked for.
#include "gsut/raster/scene_colors.h"

namespace gsut {

void GaussianColors::Evaluate(const Camera& camera, const Pose& camera_from_world,
                              std::span<const std::uint32_t> pixels, double* colors,
                              double* by_center, double* by_ray) {
  image_.resize(3 * static_cast<std::size_t>(camera.width()) * camera.height());
  TiledOptions options;
  options.unscented = unscented_;
  options.with_depth = false;
  options.keep_for_backward = by_center != nullptr;
  renderer_.Render(gaussians_, camera, CameraMotion(camera_from_world), settings_, options,
                   image_.data(), nullptr, nullptr);
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      colors[3 * i + c] = static_cast<double>(image_[3 * std::size_t{pixels[i]} + c]);
    }
  }
  if (by_center != nullptr) renderer_.Jacobian(pixels, by_center, by_ray);
}

}  // namespace gsut
