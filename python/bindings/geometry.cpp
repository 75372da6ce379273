// Binds gsut/geometry: 4x4 matrices in and out.
#include "bindings/geometry.h"

#include <pybind11/pybind11.h>

#include "bindings/arrays.h"
#include "bindings/module.h"

namespace gsut::bindings {

Pose ReadPose(const py::handle& object) {
  py::object matrix = py::reinterpret_borrow<py::object>(object);
  if (py::hasattr(matrix, "matrix")) matrix = matrix.attr("matrix");
  const auto array = ReadArray<double>(matrix, "camera_from_world", {4, 4});
  return Pose::FromMatrix(
      Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(array.data()));
}

CameraMotion ReadMotion(const py::handle& object) {
  if (py::isinstance<CameraMotion>(object)) return object.cast<CameraMotion>();
  return CameraMotion(ReadPose(object));
}

py::array_t<double> WritePose(const Pose& pose) {
  py::array_t<double> array({4, 4});
  Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(array.mutable_data()) = pose.Matrix();
  return array;
}

void BindGeometry(py::module_& m) {
  py::class_<Shutter>(m, "Shutter")
      .def(py::init([](const std::string& direction, const py::object& parity) {
             return Shutter::Named(direction,
                                   parity.is_none() ? std::string() : std::string(py::str(parity)));
           }),
           py::arg("direction") = "global", py::arg("parity") = py::none())
      .def_property_readonly("direction", &Shutter::DirectionName)
      .def_property_readonly("parity",
                             [](const Shutter& shutter) -> py::object {
                               if (!shutter.gsplat_parity) return py::none();
                               return py::str("gsplat");
                             })
      .def_property_readonly("is_global", &Shutter::IsGlobal)
      .def(
          "line_times",
          [](const Shutter& shutter, int width, int height) {
            const int lines = shutter.NumLines(width, height);
            auto times = NewArray<double>({lines});
            for (int i = 0; i < lines; ++i) {
              times.mutable_at(i) = shutter.LineTime(i, width, height);
            }
            return times;
          },
          py::arg("width"), py::arg("height"));
  py::class_<CameraMotion>(m, "CameraMotion")
      .def(py::init([](const py::handle& start, const py::handle& end, const Shutter& shutter) {
             return CameraMotion(ReadPose(start), ReadPose(end), shutter);
           }),
           py::arg("start"), py::arg("end"), py::arg("shutter"))
      .def_property_readonly("start",
                             [](const CameraMotion& motion) { return WritePose(motion.start); })
      .def_property_readonly("end",
                             [](const CameraMotion& motion) { return WritePose(motion.end); })
      .def_readonly("shutter", &CameraMotion::shutter)
      .def(
          "at", [](const CameraMotion& motion, double t) { return WritePose(motion.At(t)); },
          py::arg("t"));
  m.def(
      "exp_pose",
      [](const py::handle& xi) {
        const auto array = ReadArray<double>(xi, "xi", {6});
        return WritePose(ExpPose(Eigen::Map<const Eigen::Matrix<double, 6, 1>>(array.data())));
      },
      py::arg("xi"), "4x4 matrix of a twist (v, w): the left perturbation of a pose.");
  m.def(
      "interpolate_pose",
      [](const py::handle& start, const py::handle& end, double t) {
        return WritePose(Interpolate(ReadPose(start), ReadPose(end), t));
      },
      py::arg("start"), py::arg("end"), py::arg("t"),
      "Pose between two: translation lerp, rotation slerp.");
  m.def(
      "checked_pose", [](const py::handle& matrix) { return WritePose(ReadPose(matrix)); },
      py::arg("matrix"), "The pose with its rotation made orthonormal; InputError if it is none.");
}

}  // namespace gsut::bindings
