// Gaussians as the scene of photometric refinement.
#pragma once

#include <vector>

#include "gsut/gaussians/gaussians.h"
#include "gsut/poses/photometric.h"
#include "gsut/raster/render.h"

namespace gsut {

// Renders with buffers that only grow. The arrays behind the Gaussians must live, unchanged.
class GaussianColors : public SceneColors {
 public:
  GaussianColors(const GaussiansView<const float>& gaussians, const RenderSettings& settings,
                 const UnscentedOptions& unscented)
      : gaussians_(gaussians), settings_(settings), unscented_(unscented) {}

  void Evaluate(const Camera& camera, const Pose& camera_from_world,
                std::span<const std::uint32_t> pixels, double* colors, double* by_center,
                double* by_ray) override;

 private:
  GaussiansView<const float> gaussians_;
  RenderSettings settings_;
  UnscentedOptions unscented_;
  Renderer renderer_;
  std::vector<float> image_;
};

}  // namespace gsut
