// Binds gsut/poses: 4x4 matrices in and out.
#include "bindings/poses.h"

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

py::array_t<double> WritePose(const Pose& pose) {
  py::array_t<double> array({4, 4});
  Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(array.mutable_data()) = pose.Matrix();
  return array;
}

void BindPoses(py::module_& m) {
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
