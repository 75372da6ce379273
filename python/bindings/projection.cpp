// Binds gsut/projection.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "bindings/arrays.h"
#include "bindings/module.h"
#include "bindings/poses.h"
#include "gsut/projection/project.h"
#include "gsut/projection/project_moving.h"

namespace gsut::bindings {
namespace {

UnscentedOptions Options(double alpha, double beta, double kappa) { return {alpha, beta, kappa}; }

py::dict ProjectFloat(const py::object& gaussians, const Camera& camera, const py::object& pose,
                      double alpha, double beta, double kappa, double alpha_min) {
  const auto view = ConstGaussians<float>(gaussians);
  const Pose camera_from_world = ReadPose(pose);
  Splats splats;
  {
    const py::gil_scoped_release release;
    Project(view, camera, camera_from_world, Options(alpha, beta, kappa), {alpha_min, 0.0},
            &splats);
  }
  const py::ssize_t n = static_cast<py::ssize_t>(view.size);
  py::array_t<float> centers({n, py::ssize_t{2}}), extents({n, py::ssize_t{2}}), depths(n);
  py::array_t<float> covariances({n, py::ssize_t{2}, py::ssize_t{2}});
  py::array_t<std::uint8_t> status(n);
  for (py::ssize_t i = 0; i < n; ++i) {
    const std::size_t j = static_cast<std::size_t>(i);
    centers.mutable_at(i, 0) = splats.u[j];
    centers.mutable_at(i, 1) = splats.v[j];
    extents.mutable_at(i, 0) = splats.extent_u[j];
    extents.mutable_at(i, 1) = splats.extent_v[j];
    covariances.mutable_at(i, 0, 0) = splats.cov_uu[j];
    covariances.mutable_at(i, 0, 1) = covariances.mutable_at(i, 1, 0) = splats.cov_uv[j];
    covariances.mutable_at(i, 1, 1) = splats.cov_vv[j];
    depths.mutable_at(i) = splats.distance[j];
    status.mutable_at(i) = static_cast<std::uint8_t>(splats.status[j]);
  }
  py::dict out;
  out["centers"] = centers;
  out["covariances"] = covariances;
  out["extents"] = extents;
  out["depths"] = depths;
  out["status"] = status;
  return out;
}

py::dict ProjectDouble(const py::object& gaussians, const Camera& camera, const py::object& pose,
                       double alpha, double beta, double kappa) {
  const auto view = ConstGaussians<double>(gaussians);
  const Pose camera_from_world = ReadPose(pose);
  const py::ssize_t n = static_cast<py::ssize_t>(view.size);
  py::array_t<double> centers({n, py::ssize_t{2}});
  py::array_t<double> covariances({n, py::ssize_t{2}, py::ssize_t{2}});
  py::array_t<std::uint8_t> valid(n);
  double* centers_data = centers.mutable_data();
  double* covariances_data = covariances.mutable_data();
  std::uint8_t* valid_data = valid.mutable_data();
  {
    const py::gil_scoped_release release;
    ProjectReference(view, camera, camera_from_world, Options(alpha, beta, kappa), centers_data,
                     covariances_data, valid_data);
  }
  py::dict out;
  out["centers"] = centers;
  out["covariances"] = covariances;
  out["valid"] = valid;
  return out;
}

py::dict ProjectMotion(const py::object& gaussians, const Camera& camera,
                       const CameraMotion& motion, double alpha, double beta, double kappa) {
  const auto view = ConstGaussians<double>(gaussians);
  const py::ssize_t n = static_cast<py::ssize_t>(view.size);
  py::array_t<double> centers({n, py::ssize_t{2}});
  py::array_t<double> covariances({n, py::ssize_t{2}, py::ssize_t{2}});
  py::array_t<std::uint8_t> valid(n), converged(n);
  double* centers_data = centers.mutable_data();
  double* covariances_data = covariances.mutable_data();
  std::uint8_t* valid_data = valid.mutable_data();
  std::uint8_t* converged_data = converged.mutable_data();
  {
    const py::gil_scoped_release release;
    ProjectMoving(view, camera, motion, Options(alpha, beta, kappa), centers_data, covariances_data,
                  valid_data, converged_data);
  }
  py::dict out;
  out["centers"] = centers;
  out["covariances"] = covariances;
  out["valid"] = valid;
  out["converged"] = converged;
  return out;
}

}  // namespace

void BindProjection(py::module_& m) {
  m.def("project_moving", &ProjectMotion, py::arg("gaussians"), py::arg("camera"),
        py::arg("motion"), py::arg("alpha"), py::arg("beta"), py::arg("kappa"));
  m.def("project", &ProjectFloat, py::arg("gaussians"), py::arg("camera"),
        py::arg("camera_from_world"), py::arg("alpha"), py::arg("beta"), py::arg("kappa"),
        py::arg("alpha_min"));
  m.def("project_reference", &ProjectDouble, py::arg("gaussians"), py::arg("camera"),
        py::arg("camera_from_world"), py::arg("alpha"), py::arg("beta"), py::arg("kappa"));
}

}  // namespace gsut::bindings
