// What the bindings of the renderers share: jobs, settings and the reference's arrays.
#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include "bindings/arrays.h"
#include "gsut/raster/lens_gradients.h"
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
  py::object features, features_background;  // (N, D), (D,), or None
};

// Reads the channels of a job; its arrays must outlive the result.
template <class T>
Channels<T> ChannelsOf(const BoundJob& job, std::int64_t num_gaussians) {
  if (job.features.is_none()) return {};
  Channels<T> out;
  out.values = ConstData<T>(job.features, "features", {num_gaussians, kAny});
  const std::int64_t count = py::reinterpret_borrow<py::array>(job.features).shape(1);
  out.background = ConstData<T>(job.features_background, "features_background", {count});
  out.count = static_cast<int>(count);
  return out;
}

// dpose (6,) of one pose, or (2, 6) of the start and the end of a rolling shutter.
inline py::array_t<double> PoseGradient(const double* dpose, const CameraMotion& motion) {
  if (motion.shutter.IsGlobal()) {
    py::array_t<double> out(6);
    std::copy_n(dpose, 6, out.mutable_data());
    return out;
  }
  py::array_t<double> out({2, 6});
  std::copy_n(dpose, 12, out.mutable_data());
  return out;
}

// The gradients to an image's rays and to the lens behind them.
struct LensGradient {
  RayGradients to_rays;
  std::vector<double> to_params;

  // Also leaves only the part of the gradients that is across the ray: the rest has no meaning.
  void Chain(const Camera& camera, const CameraMotion& motion) {
    const ViewRays view = MakeViewRays(camera, motion);
    to_params = ChainToLens(view, camera, motion, to_rays);
    for (std::size_t i = 0; i < view.valid.size(); ++i) {
      if (!view.valid[i]) continue;
      const Eigen::Map<const Eigen::Vector3d> ray(&view.rays[3 * i]);
      Eigen::Map<Eigen::Vector3d> gradient(&to_rays.rays[3 * i]);
      gradient -= ray * ray.dot(gradient);
    }
  }

  // (params (K,), rays (H, W, 3)), or None if not wanted.
  py::object Arrays(const Camera& camera, bool wanted) const {
    if (!wanted) return py::none();
    py::array_t<double> params(static_cast<py::ssize_t>(to_params.size()));
    std::copy(to_params.begin(), to_params.end(), params.mutable_data());
    auto rays = NewArray<double>({camera.height(), camera.width(), 3});
    std::copy(to_rays.rays.begin(), to_rays.rays.end(), rays.mutable_data());
    return py::make_tuple(params, rays);
  }
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
  if (result.channels.empty()) return py::make_tuple(image, alpha, depth, samples, distortion);
  py::array_t<double> channels({h, w, static_cast<py::ssize_t>(result.channels.size()) / (h * w)});
  std::copy(result.channels.begin(), result.channels.end(), channels.mutable_data());
  return py::make_tuple(image, alpha, depth, samples, distortion, channels);
}

}  // namespace gsut::bindings
