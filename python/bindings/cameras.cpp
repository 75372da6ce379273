// Binds gsut/cameras.
//
// The package's Camera wraps this one and adds checks, file formats and fits; here are the lens'
// functions on arrays. Points and rays are in camera axes (x right, y down, z forward), pixel (0.5,
// 0.5) is the centre of the top-left one, and all numbers are double.
#include <pybind11/operators.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <numeric>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "gsut/cameras/camera.h"
#include "gsut/cameras/lens_traits.h"
#include "gsut/formats/camera_model.h"

namespace gsut::bindings {
namespace {

// numpy's bool is a byte of 0 or 1, which is what the core writes.
std::uint8_t* MaskData(py::array_t<bool>& mask) {
  return reinterpret_cast<std::uint8_t*>(mask.mutable_data());
}

// (pixels (N, 2), valid (N,)) of points (N, 3), all float64. A point without an image is data, not
// an error: its pixel is NaN and `valid` false. Pointers are taken before the GIL goes.
py::tuple Project(const Camera& camera, const py::object& points_in_camera) {
  const auto points = ReadArray<double>(points_in_camera, "points_in_camera", {kAny, 3});
  const py::ssize_t count = points.shape(0);
  auto pixels = NewArray<double>({count, 2});
  auto valid = NewArray<bool>({count});
  const double* in = points.data();
  double* out = pixels.mutable_data();
  std::uint8_t* mask = MaskData(valid);
  {
    const LongCall released;
    camera.Project(count, in, out, mask);
  }
  return py::make_tuple(pixels, valid);
}

// (unit rays (N, 3), valid (N,)) of pixels (N, 2), which may lie outside the image.
py::tuple Unproject(const Camera& camera, const py::object& pixels_object) {
  const auto pixels = ReadArray<double>(pixels_object, "pixels", {kAny, 2});
  const py::ssize_t count = pixels.shape(0);
  auto rays = NewArray<double>({count, 3});
  auto valid = NewArray<bool>({count});
  const double* in = pixels.data();
  double* out = rays.mutable_data();
  std::uint8_t* mask = MaskData(valid);
  {
    const LongCall released;
    camera.Unproject(count, in, out, mask);
  }
  return py::make_tuple(rays, valid);
}

// Derivatives by all parameters or none, or the indices of some.
using ChosenParams = std::variant<bool, std::vector<int>>;

std::vector<int> ListParams(const Camera& camera, const ChosenParams& with_params) {
  if (const auto* indices = std::get_if<std::vector<int>>(&with_params)) {
    for (const int index : *indices) {
      if (index >= 0 && index < camera.num_params()) continue;
      throw InputError("with_params names parameter " + std::to_string(index) + " of " +
                       std::to_string(camera.num_params()));
    }
    return *indices;
  }
  std::vector<int> all(camera.num_params());
  std::iota(all.begin(), all.end(), 0);
  return all;
}

// (dpixel_dpoint (N, 2, 3), dpixel_dparams (N, 2, F)), NaN where a point has no image. The pixels,
// which come with them, are not returned: `project` has them. with_params: a bool, all parameters
// or none, which takes a fraction of the time; or the indices of F of them.
py::tuple ProjectJacobian(const Camera& camera, const py::object& points_in_camera,
                          const ChosenParams& with_params) {
  const auto points = ReadArray<double>(points_in_camera, "points_in_camera", {kAny, 3});
  const std::vector<int> chosen = ListParams(camera, with_params);
  const bool* all = std::get_if<bool>(&with_params);
  const bool none = all != nullptr && !*all;
  const py::ssize_t count = points.shape(0);
  auto pixels = NewArray<double>({count, 2});
  auto valid = NewArray<bool>({count});
  auto dpixel_dpoint = NewArray<double>({count, 2, 3});
  auto dpixel_dparams =
      NewArray<double>({none ? 0 : count, 2, static_cast<py::ssize_t>(chosen.size())});
  const double* in = points.data();
  double* out = pixels.mutable_data();
  std::uint8_t* mask = MaskData(valid);
  double* of_point = dpixel_dpoint.mutable_data();
  double* of_params = none ? nullptr : dpixel_dparams.mutable_data();
  {
    const LongCall released;
    camera.ProjectJacobian(count, in, out, mask, of_point, of_params, chosen);
  }
  return py::make_tuple(dpixel_dpoint, dpixel_dparams);
}

// Views of the table that all copies of the camera share, kept alive by a copy; read-only.
py::tuple Rays(const Camera& camera) {
  const RayTable* table = nullptr;
  {
    const LongCall released;
    table = &camera.Rays();
  }
  const auto owner =
      py::capsule(new Camera(camera), [](void* copy) { delete static_cast<Camera*>(copy); });
  const py::ssize_t height = camera.height();
  const py::ssize_t width = camera.width();
  // The arrays own no memory: they point into the table, and the capsule's copy of the camera keeps
  // that alive. Hence they must not be written to.
  const py::array rays(py::dtype::of<double>(), {height, width, py::ssize_t{3}}, {},
                       table->rays.data(), owner);
  const py::array valid(py::dtype::of<bool>(), {height, width}, {}, table->valid.data(), owner);
  rays.attr("setflags")(py::arg("write") = false);
  valid.attr("setflags")(py::arg("write") = false);
  return py::make_tuple(rays, valid);
}

// Origins in camera axes, of which a central lens stores none.
// Views of the table, as Rays(); zeros for a central lens.
py::array Origins(const Camera& camera) {
  const py::ssize_t height = camera.height();
  const py::ssize_t width = camera.width();
  if (camera.IsCentral()) {
    auto zeros = NewArray<double>({height, width, 3});
    std::fill_n(zeros.mutable_data(), zeros.size(), 0.0);
    return zeros;
  }
  const RayTable* table = nullptr;
  {
    const LongCall released;
    table = &camera.Rays();
  }
  const auto owner =
      py::capsule(new Camera(camera), [](void* copy) { delete static_cast<Camera*>(copy); });
  const py::array origins(py::dtype::of<double>(), {height, width, py::ssize_t{3}}, {},
                          table->origins.data(), owner);
  origins.attr("setflags")(py::arg("write") = false);
  return origins;
}

// (origins (N, 3), valid (N,)) of the pixels' rays; of a central lens all zero.
py::tuple RayOrigins(const Camera& camera, const py::object& pixels_object) {
  const auto pixels = ReadArray<double>(pixels_object, "pixels", {kAny, 2});
  const py::ssize_t count = pixels.shape(0);
  auto rays = NewArray<double>({count, 3});
  auto origins = NewArray<double>({count, 3});
  auto valid = NewArray<bool>({count});
  const double* in = pixels.data();
  double* of_rays = rays.mutable_data();
  double* of_origins = origins.mutable_data();
  std::uint8_t* mask = MaskData(valid);
  {
    const LongCall released;
    camera.UnprojectLines(count, in, of_origins, of_rays, mask);
  }
  return py::make_tuple(origins, valid);
}

// The real lenses that a model's file gives as examples: (where from, parameters, width, height).
py::list Examples(const std::string& model) {
  py::list examples;
  for (const LensExample& example : LensExamples(LensFromName(model))) {
    const std::vector<double> params(example.params, example.params + example.num_params);
    examples.append(py::make_tuple(example.origin, params, example.width, example.height));
  }
  return examples;
}

// mrcal's valid_region: the corners of a polygon of pixels; None: the whole image.
using Region = std::optional<std::vector<std::array<double, 2>>>;

// (camera, extrinsics, valid_region or None) of a .cameramodel file's text.
py::tuple ParseModel(const std::string& text, const std::string& source) {
  const CameraModelFile file = ParseCameraModel(text, source);
  return py::make_tuple(file.camera, file.extrinsics, file.valid_region);
}

// The inverse: the text of a file that reads back as the same camera.
std::string FormatModel(const Camera& camera, const std::array<double, 6>& extrinsics,
                        const Region& valid_region) {
  return FormatCameraModel({camera, extrinsics, valid_region});
}

}  // namespace

void BindCameras(py::module_& m) {
  py::class_<Camera>(m, "Camera")
      .def(py::init<std::string_view, std::vector<double>, int, int, double>(), py::arg("model"),
           py::arg("params"), py::arg("width"), py::arg("height"),
           py::arg("valid_field_angle") = kInfinity)
      .def_property_readonly("model", &Camera::model)
      .def_property_readonly("params",
                             [](const Camera& camera) {
                               return py::array_t<double>(camera.num_params(),
                                                          camera.params().data());
                             })
      .def_property_readonly("width", &Camera::width)
      .def_property_readonly("height", &Camera::height)
      .def_property_readonly("max_angle", &Camera::MaxAngle)
      .def_property_readonly("valid_field_angle", &Camera::valid_field_angle)
      .def("project", &Project, py::arg("points_in_camera"))
      .def("unproject", &Unproject, py::arg("pixels"))
      .def("project_jacobian", &ProjectJacobian, py::arg("points_in_camera"),
           py::arg("with_params") = true)
      .def("rays", &Rays)
      .def("origins", &Origins)
      .def("ray_origins", &RayOrigins, py::arg("pixels"))
      .def_property_readonly("is_central", &Camera::IsCentral)
      .def_property_readonly("is_parallel", &Camera::IsParallel)
      // A domain without an edge function is a cone about the axis, bounded by max_angle alone.
      .def_property_readonly("is_cone",
                             [](const Camera& camera) { return camera.domain().edge == nullptr; })
      .def_property_readonly("is_panorama",
                             [](const Camera& camera) { return camera.domain().IsPanorama(); })
      .def_property_readonly(
          "period",
          [](const Camera& camera) {
            return std::array<double, 2>{camera.domain().period_u, camera.domain().period_v};
          })
      // Cameras are values: these return new ones, and equal ones compare equal.
      .def("resize", &Camera::Resized, py::arg("width"), py::arg("height"))
      .def("with_valid_field_angle", &Camera::WithValidFieldAngle, py::arg("valid_field_angle"))
      .def(py::self == py::self);
  // By the name of a model, without a camera: what Python lists, checks and fits with.
  m.def("camera_models", &LensNames);
  m.def(
      "camera_param_names",
      [](const std::string& model) { return std::string(LensParamNames(LensFromName(model))); },
      py::arg("model"));
  m.def("parse_camera_model", &ParseModel, py::arg("text"), py::arg("source"));
  m.def("format_camera_model", &FormatModel, py::arg("camera"), py::arg("extrinsics"),
        py::arg("valid_region"));
  m.def("camera_examples", &Examples, py::arg("model"));
  // What a model can do, as flags: Python asks these and never a model's name. choices: of
  // parameters that are chosen, not fitted; fit_held, fit_near: held, or kept near their start, in
  // a fit.
  py::class_<LensTraits>(m, "LensTraits")
      .def_readonly("choices", &LensTraits::choices)
      .def_readonly("fit_held", &LensTraits::fit_held)
      .def_readonly("fit_near", &LensTraits::fit_near)
      .def_readonly("has_table", &LensTraits::has_table)
      .def_readonly("is_central", &LensTraits::is_central)
      .def_readonly("is_parallel", &LensTraits::is_parallel);
  m.def(
      "camera_traits", [](const std::string& model) { return TraitsOf(LensFromName(model)); },
      py::arg("model"));
  m.def(
      "camera_accepts_params",
      [](const std::string& model, int num_params) {
        return LensAcceptsParams(LensFromName(model), num_params);
      },
      py::arg("model"), py::arg("num_params"));
  // Parameter vectors from which a fit may start, given focal lengths and centre in pixels and the
  // largest field angle in radians.
  m.def(
      "camera_fit_starts",
      [](const std::string& model, const std::array<double, 2>& focal,
         const std::array<double, 2>& center, double max_angle) {
        return LensFitStarts(LensFromName(model),
                             {focal[0], focal[1], center[0], center[1], max_angle});
      },
      py::arg("model"), py::arg("focal"), py::arg("center"), py::arg("max_angle"));
}

}  // namespace gsut::bindings
