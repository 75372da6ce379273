// What only tests call: derivatives of colours, and the double reference along lines that are given
// one by one, so that a test may aim each of them.
#include "references.h"

#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "bindings/geometry.h"
#include "bindings/raster.h"

namespace gsut::bindings {
namespace {

using Eigen::Map;
using Eigen::Vector3d;

// Colours (count, 3) of pixels and their derivatives by centre and ray, each (count, 3, 3). A model
// along the ray is drawn by the distance, as for refinement.
py::tuple ColorJacobian(const py::object& gaussians, const BoundJob& bound,
                        const py::object& pixels) {
  const auto view = ConstGaussians<float>(gaussians);
  const auto chosen = ReadArray<std::uint32_t>(pixels, "pixels", {kAny});
  const auto count = static_cast<py::ssize_t>(chosen.size());
  RenderJob job = {bound.camera, bound.motion, bound.settings, bound.unscented};
  BlendRule& rule = job.settings.rule;
  rule = rule.For(view.order);
  if (rule.order == OrderKey::kRay) rule.order = OrderKey::kDistance;
  std::vector<float> image(3 * static_cast<std::size_t>(job.camera.width()) * job.camera.height());
  job.image = image.data();
  auto colors = NewArray<double>({count, 3});
  auto by_center = NewArray<double>({count, 3, 3});
  auto by_ray = NewArray<double>({count, 3, 3});
  Renderer renderer;
  renderer.Render(view, job);
  renderer.Jacobian({chosen.data(), static_cast<std::size_t>(count)}, by_center.mutable_data(),
                    by_ray.mutable_data());
  for (py::ssize_t i = 0; i < count; ++i) {
    for (py::ssize_t c = 0; c < 3; ++c) {
      const auto at = 3 * std::size_t{chosen.at(i)} + static_cast<std::size_t>(c);
      colors.mutable_at(i, c) = static_cast<double>(image.at(at));
    }
  }
  return py::make_tuple(colors, by_center, by_ray);
}

// Rays given one by one: lines (H, W, 6), origins and unit directions in the world. Directions are
// taken as given, their length scales the distance.
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
  for (std::size_t i = 0; i < pixels; ++i) {
    const Map<const Vector3d> origin(array.data() + 6 * i), ray(array.data() + 6 * i + 3);
    Map<Vector3d>(&view.rays[3 * i]) = view.reference.rotation * ray;
    Map<Vector3d>(&view.origins[3 * i]) =
        view.reference.rotation * origin + view.reference.translation;
  }
  return view;
}

// (image, alpha, depth, samples, distortion), (H, W, ...) each: the reference along any lines at
// all, with which lenses of every kind are compared. Background 0, harmonics of all degrees.
py::tuple RenderLines(const py::object& gaussians, const py::object& lines,
                      const py::object& reference, const BlendRule& rule) {
  const ViewRays rays = RaysOfLines(lines, reference);
  const ReferenceImage result =
      RenderReference(ConstGaussians<double>(gaussians), rays, Settings(rule, {0, 0, 0}, 3));
  return ReferenceArrays(result, rays.height, rays.width);
}

}  // namespace

void BindReferences(py::module_& m) {
  m.def("color_jacobian", &ColorJacobian, py::arg("gaussians"), py::arg("job"), py::arg("pixels"));
  m.def("render_lines_reference", &RenderLines, py::arg("gaussians"), py::arg("lines"),
        py::arg("reference"), py::arg("rule"));
}

}  // namespace gsut::bindings
