// What the bindings of the renderers share: jobs, settings and the reference's arrays.
#pragma once

#include <algorithm>
#include <array>

#include "bindings/arrays.h"
#include "gsut/raster/reference/reference.h"
#include "gsut/raster/render.h"

namespace gsut::bindings {

inline RenderSettings Settings(const BlendRule& rule, const std::array<double, 3>& background,
                               int sh_degree) {
  RenderSettings settings;
  settings.rule = rule;
  std::copy(background.begin(), background.end(), settings.background);
  settings.sh_degree = sh_degree;
  return settings;
}

// What an image shows and how, without the arrays that it fills: RenderJob of the Python module.
struct BoundJob {
  Camera camera;
  CameraMotion motion;
  RenderSettings settings;
  UnscentedOptions unscented;
  py::object tiles;
  bool keep;
};

inline py::tuple ReferenceArrays(const ReferenceImage& result, py::ssize_t h, py::ssize_t w) {
  py::array_t<double> image({h, w, py::ssize_t{3}}), alpha({h, w}), depth({h, w});
  py::array_t<double> distortion({h, w});
  py::array_t<int> samples({h, w});
  std::copy(result.image.begin(), result.image.end(), image.mutable_data());
  std::copy(result.alpha.begin(), result.alpha.end(), alpha.mutable_data());
  std::copy(result.depth.begin(), result.depth.end(), depth.mutable_data());
  std::copy(result.samples.begin(), result.samples.end(), samples.mutable_data());
  std::copy(result.distortion.begin(), result.distortion.end(), distortion.mutable_data());
  return py::make_tuple(image, alpha, depth, samples, distortion);
}

}  // namespace gsut::bindings
