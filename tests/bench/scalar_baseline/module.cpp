// The Python module gsut_scalar_baseline: the scalar renderer that ./run bench compares with, and
// what only tests call.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>

#include "bindings/arrays.h"
#include "gsut/base/parallel.h"
#include "references.h"
#include "scalar_renderer.h"

namespace gsut::bindings {
namespace {

class BoundScalarRenderer {
 public:
  explicit BoundScalarRenderer(double widen) : renderer_(widen) {}

  void Render(const py::object& gaussians, const Camera& camera, const py::object& pose,
              const BlendRule& rule, const std::array<double, 3>& background, int sh_degree,
              const std::array<double, 3>& unscented, const py::object& image,
              const py::object& alpha) {
    const auto view = ConstGaussians<float>(gaussians);
    const auto matrix = ReadArray<double>(pose, "camera_from_world", {4, 4});
    const Pose camera_from_world = Pose::FromMatrix(
        Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(matrix.data()));
    height_ = camera.height();
    width_ = camera.width();
    float* image_data = MutableData<float>(image, "image", {height_, width_, 3});
    float* alpha_data = MutableData<float>(alpha, "alpha", {height_, width_});
    RenderSettings settings;
    settings.rule = rule;
    std::copy(background.begin(), background.end(), settings.background);
    settings.sh_degree = sh_degree;
    gaussians_ = gaussians;
    const py::gil_scoped_release release;
    renderer_.Render(view, camera, camera_from_world, settings,
                     {unscented[0], unscented[1], unscented[2]}, image_data, alpha_data);
  }

  void Backward(const py::object& dimage, const py::object& gradients) {
    const float* image = ConstData<float>(dimage, "dimage", {height_, width_, 3});
    const auto view = MutableGaussians<float>(gradients);
    const py::gil_scoped_release release;
    renderer_.Backward(image, view);
  }

  py::dict Timings() const {
    py::dict out;
    for (const StageTime& time : renderer_.timings()) {
      out[time.stage] = py::make_tuple(time.wall_seconds, time.cpu_seconds);
    }
    return out;
  }

  py::dict Statistics() const {
    py::dict out;
    out["num_pairs"] = renderer_.num_pairs();
    out["num_evaluated"] = renderer_.num_evaluated();
    out["num_blended"] = renderer_.num_blended();
    return out;
  }

 private:
  ScalarRenderer renderer_;
  py::object gaussians_;
  std::int64_t height_ = 0, width_ = 0;
};

}  // namespace
}  // namespace gsut::bindings

PYBIND11_MODULE(gsut_scalar_baseline, m) {
  namespace py = pybind11;
  using gsut::bindings::BoundScalarRenderer;
  m.doc() = "The plain scalar float renderer, the baseline of ./run bench.";
  // This module has the thread pool of its own copy of gsut/base.
  m.def("set_num_threads", &gsut::SetNumThreads, py::arg("num_threads"));
  py::class_<BoundScalarRenderer>(m, "ScalarRenderer")
      .def(py::init<double>(), py::arg("widen") = 1.0)
      .def("render", &BoundScalarRenderer::Render, py::arg("gaussians"), py::arg("camera"),
           py::arg("camera_from_world"), py::arg("rule"), py::arg("background"),
           py::arg("sh_degree"), py::arg("unscented"), py::arg("image"), py::arg("alpha"))
      .def("backward", &BoundScalarRenderer::Backward, py::arg("dimage"), py::arg("gradients"))
      .def("timings", &BoundScalarRenderer::Timings)
      .def("statistics", &BoundScalarRenderer::Statistics);
  gsut::bindings::BindReferences(m);
}
