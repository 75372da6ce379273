// Binds the double reference: through a lens, and along rays that are given one by one.
//
// Lines need no camera, so that a test may aim each of them. Everything is double.
#include <pybind11/pybind11.h>

#include "bindings/geometry.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "bindings/raster.h"

namespace gsut::bindings {
namespace {

// Rays given one by one: lines (H, W, 6), origins and unit directions in the world.
ViewRays RaysOfLines(const py::object& lines, const py::object& reference) {
  const auto array = ReadArray<double>(lines, "lines", {kAny, kAny, 6});
  ViewRays view;
  view.height = static_cast<int>(array.shape(0));
  view.width = static_cast<int>(array.shape(1));
  view.reference = ReadPose(reference);
  const std::size_t pixels = static_cast<std::size_t>(array.size()) / 6;
  view.rays.resize(3 * pixels);
  view.origins.resize(3 * pixels);
  view.valid.assign(pixels, 1);
  // A pixel a line; directions are taken as given, their length scales the distance.
  using Eigen::Vector3d;
  for (std::size_t i = 0; i < pixels; ++i) {
    const Eigen::Map<const Vector3d> origin(array.data() + 6 * i), ray(array.data() + 6 * i + 3);
    Eigen::Map<Vector3d>(&view.rays[3 * i]) = view.reference.rotation * ray;
    Eigen::Map<Vector3d>(&view.origins[3 * i]) =
        view.reference.rotation * origin + view.reference.translation;
  }
  return view;
}

// (image, alpha, depth, distortion, samples), (H, W, ...) each: the reference along any lines at
// all, with which lenses of every kind are compared. Background 0, harmonics of all degrees.
py::tuple RenderLines(const py::object& gaussians, const py::object& lines,
                      const py::object& reference, const BlendRule& rule) {
  const ViewRays rays = RaysOfLines(lines, reference);
  const auto view = ConstGaussians<double>(gaussians);
  const RenderSettings settings = Settings(rule, {0, 0, 0}, 3);
  ReferenceImage result;
  {
    const LongCall released;
    result = RenderReference(view, rays, settings);
  }
  return ReferenceArrays(result, rays.height, rays.width);
}

// `gradients` is overwritten by those to the Gaussians.
// The gradients to the lines (H, W, 6), in the world.
py::array_t<double> BackwardLines(const py::object& gaussians, const py::object& lines,
                                  const py::object& reference, const BlendRule& rule,
                                  const py::object& dimage, const py::object& dalpha,
                                  const py::object& ddepth, const py::object& gradients) {
  const ViewRays view = RaysOfLines(lines, reference);
  const std::int64_t h = view.height, w = view.width;
  const auto scene = ConstGaussians<double>(gaussians);
  const double* image = ConstData<double>(dimage, "dimage", {h, w, 3});
  const double* alpha = OptionalData<double>(dalpha, "dalpha", {h, w});
  const double* depth = OptionalData<double>(ddepth, "ddepth", {h, w});
  const auto sums = MutableGaussians<double>(gradients);
  // Gradients to lines come out beside those to the Gaussians; none to a pose, as there is none.
  const RenderSettings settings = Settings(rule, {0, 0, 0}, 3);
  RayGradients rays;
  ShadingGradient shading;
  {
    const LongCall released;
    RenderReferenceBackward(scene, view, settings, {image, alpha, depth}, sums, &rays, &shading);
  }
  // The reference's frame is the renderer's own affair: back into world axes.
  auto out = NewArray<double>({view.height, view.width, 6});
  using Eigen::Vector3d;
  const Eigen::Matrix3d to_world = view.reference.rotation.transpose();
  double* line = out.mutable_data();
  for (std::size_t i = 0; i < view.valid.size(); ++i) {
    Eigen::Map<Vector3d>(line + 6 * i) =
        to_world * Eigen::Map<const Vector3d>(&rays.origins[3 * i]);
    Eigen::Map<Vector3d>(line + 6 * i + 3) =
        to_world * Eigen::Map<const Vector3d>(&rays.rays[3 * i]);
  }
  return out;
}

// The scalar renderer in double, slow: what tests compare with.
py::tuple RenderDouble(const py::object& gaussians, const BoundJob& job, const py::object& pixels) {
  const auto view = ConstGaussians<double>(gaussians);
  const py::ssize_t h = job.camera.height(), w = job.camera.width();
  const std::uint8_t* chosen = OptionalData<std::uint8_t>(pixels, "pixels", {h, w});
  const auto channels = ChannelsOf<double>(job, view.size);
  ReferenceImage result;
  {
    const LongCall released;
    result = RenderReference(view, job.camera, job.motion, job.settings, chosen, channels);
  }
  return ReferenceArrays(result, h, w);
}

py::tuple BackwardDouble(const py::object& gaussians, const BoundJob& job, const py::object& dimage,
                         const py::object& gradients, const py::object& dalpha,
                         const py::object& ddepth, const py::object& ddistortion,
                         const py::object& pixels, bool with_lens, const py::object& dfeatures,
                         const py::object& to_features) {
  const auto view = ConstGaussians<double>(gaussians);
  const auto out = MutableGaussians<double>(gradients);
  const Camera& camera = job.camera;
  const CameraMotion& motion = job.motion;
  const std::int64_t h = camera.height(), w = camera.width();
  ReferenceGradients to_image = {ConstData<double>(dimage, "dimage", {h, w, 3}),
                                 OptionalData<double>(dalpha, "dalpha", {h, w}),
                                 OptionalData<double>(ddepth, "ddepth", {h, w}),
                                 OptionalData<double>(ddistortion, "ddistortion", {h, w})};
  if (!dfeatures.is_none()) {
    to_image.channels = ChannelsOf<double>(job, view.size);
    const std::int64_t count = to_image.channels.count;
    to_image.channel_image = ConstData<double>(dfeatures, "dfeatures", {h, w, count});
    to_image.to_channels = MutableData<double>(to_features, "to_features", {view.size, count});
  }
  const std::uint8_t* chosen = OptionalData<std::uint8_t>(pixels, "pixels", {h, w});
  double dpose[12] = {};
  LensGradient lens;
  {
    const LongCall released;
    RenderReferenceBackward(view, camera, motion, job.settings, to_image, out, dpose, &lens.to_rays,
                            chosen);
    if (with_lens) lens.Chain(camera, motion);
  }
  return py::make_tuple(PoseGradient(dpose, motion), lens.Arrays(camera, with_lens));
}

}  // namespace

void BindRasterLines(py::module_& m) {
  m.def("render_reference", &RenderDouble, py::arg("gaussians"), py::arg("job"),
        py::arg("pixels") = py::none());
  m.def("render_reference_backward", &BackwardDouble, py::arg("gaussians"), py::arg("job"),
        py::arg("dimage"), py::arg("gradients"), py::kw_only(), py::arg("dalpha") = py::none(),
        py::arg("ddepth") = py::none(), py::arg("ddistortion") = py::none(),
        py::arg("pixels") = py::none(), py::arg("with_lens") = false,
        py::arg("dfeatures") = py::none(), py::arg("to_features") = py::none());
  m.def("render_lines_reference", &RenderLines, py::arg("gaussians"), py::arg("lines"),
        py::arg("reference"), py::arg("rule"));
  m.def("render_lines_reference_backward", &BackwardLines, py::arg("gaussians"), py::arg("lines"),
        py::arg("reference"), py::arg("rule"), py::arg("dimage"), py::arg("dalpha"),
        py::arg("ddepth"), py::arg("gradients"));
}

}  // namespace gsut::bindings
