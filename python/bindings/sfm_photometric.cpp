// Binds photometric refinement: derivatives of colours, and poses and lenses from photographs.
//
// The solver sees the scene through an interface, SceneColors, so that structure from motion does
// not depend on the renderer; here the two meet.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <string>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/geometry.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "bindings/raster.h"
#include "gsut/raster/render.h"
#include "gsut/sfm/photometric.h"

namespace gsut::bindings {
namespace {

// Gaussians as the scene of photometric refinement: renders an image and takes out the chosen
// pixels, with buffers that only grow. The arrays behind the Gaussians must live, unchanged.
class GaussianColors : public SceneColors {
 public:
  GaussianColors(const GaussiansView<const float>& gaussians, const RenderSettings& settings,
                 const UnscentedOptions& unscented)
      : gaussians_(gaussians), settings_(settings), unscented_(unscented) {
    // Colours have no derivatives along the ray: there, those by the distance bring a pose near.
    settings_.rule = settings_.rule.For(gaussians.order);
    if (settings_.rule.order == OrderKey::kRay) settings_.rule.order = OrderKey::kDistance;
  }

  // Colours of chosen pixels, float32 rendered and widened; by_center null: no derivatives wanted,
  // which saves keeping what the backward pass would read.
  void Evaluate(const Camera& camera, const Pose& camera_from_world,
                std::span<const std::uint32_t> pixels, double* colors, double* by_center,
                double* by_ray) override {
    image_.resize(3 * static_cast<std::size_t>(camera.width()) * camera.height());
    RenderJob job = {camera, CameraMotion(camera_from_world), settings_, unscented_};
    job.keep_for_backward = by_center != nullptr;
    job.image = image_.data();
    renderer_.Render(gaussians_, job);
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        colors[3 * i + c] = static_cast<double>(image_[3 * std::size_t{pixels[i]} + c]);
      }
    }
    if (by_center != nullptr) renderer_.Jacobian(pixels, by_center, by_ray);
  }

 private:
  GaussiansView<const float> gaussians_;
  RenderSettings settings_;
  UnscentedOptions unscented_;
  Renderer renderer_;
  std::vector<float> image_;
};

// Row-major indices of pixels; the core checks that they lie in the image.
std::vector<std::uint32_t> ReadChosen(const py::handle& object) {
  const auto array = ReadArray<std::uint32_t>(object, "pixels", {kAny});
  return {array.data(), array.data() + array.size()};
}

// Unknown settings are refused, so that a misspelt one is not silently its default.
PhotometricRefinementOptions ReadOptions(const py::dict& values) {
  PhotometricRefinementOptions options;  // one thread of Ceres: its sums differ with their number
  SettingsReader settings(values, "refine_photometric");
  settings.Read("loss_scale", &options.loss_scale);
  settings.Read("max_iterations", &options.max_iterations);
  settings.Read("function_tolerance", &options.function_tolerance);
  settings.Read("with_gain", &options.with_gain);
  settings.Read("lens_free", &options.lens_free);
  settings.CheckAllRead();
  return options;
}

// Poses, gains and lenses that make the renders like the photographs, by Ceres. Everything is
// copied in: the caller's objects stay as they are, and the result is a dictionary of new ones, in
// the order of `views` and `cameras`.
// views: tuples (camera index, camera_from_world, pixels (n,), colours (n, 3)).
py::dict Refine(const py::object& gaussians, const std::vector<const Camera*>& cameras,
                const py::list& views, const BlendRule& rule,
                const std::array<double, 3>& background, int sh_degree,
                const std::array<double, 3>& unscented, const py::dict& settings) {
  GaussianColors scene(ConstGaussians<float>(gaussians), Settings(rule, background, sh_degree),
                       {unscented[0], unscented[1], unscented[2]});
  std::vector<Camera> lenses;
  lenses.reserve(cameras.size());
  for (const Camera* camera : cameras) lenses.push_back(*camera);
  std::vector<PhotometricImage> images;
  // Pixels as row-major indices and their colours, float32: a photograph is compared where chosen.
  for (const py::handle& item : views) {
    const auto view = py::cast<py::tuple>(item);
    PhotometricImage image;
    image.camera = py::cast<int>(view[0]);
    image.camera_from_world = ReadPose(view[1]);
    image.pixels = ReadChosen(view[2]);
    const auto colors =
        ReadArray<float>(view[3], "colors", {static_cast<py::ssize_t>(image.pixels.size()), 3});
    image.colors.assign(colors.data(), colors.data() + colors.size());
    images.push_back(std::move(image));
  }
  // Read last: a fault of the views is the likelier one, and is named first.
  const PhotometricRefinementOptions options = ReadOptions(settings);
  PhotometricSummary summary;
  {
    const LongCall released;
    summary = RefinePhotometric(&scene, &lenses, &images, options);
  }
  // Back to Python: poses and gains an image, parameters a lens, and what the solver says of its
  // way.
  py::list poses, gains, lens_params;
  for (const PhotometricImage& image : images) {
    poses.append(WritePose(image.camera_from_world));
    gains.append(py::make_tuple(image.gain, image.bias));
  }
  for (const Camera& lens : lenses) lens_params.append(lens.params());
  py::dict out;
  out["camera_from_world"] = poses;
  out["gains"] = gains;
  out["lens_params"] = lens_params;
  out["rms_before"] = summary.rms_before;
  out["rms_after"] = summary.rms_after;
  out["iterations"] = summary.iterations;
  out["evaluations"] = summary.evaluations;
  out["converged"] = summary.converged;
  return out;
}

}  // namespace

void BindSfmPhotometric(py::module_& m) {
  m.def("refine_photometric", &Refine, py::arg("gaussians"), py::arg("cameras"), py::arg("views"),
        py::arg("rule"), py::arg("background"), py::arg("sh_degree"), py::arg("unscented"),
        py::arg("settings"));
}

}  // namespace gsut::bindings
