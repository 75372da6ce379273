// Binds gsut/projection.
//
// These are for gsut.project and tests: the renderer projects by itself. Gaussians float32 for the
// kernels, float64 for the references; outputs are new arrays in a dictionary, a row a Gaussian.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <string>

#include "bindings/arrays.h"
#include "bindings/geometry.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "gsut/projection/project.h"
#include "gsut/projection/project_moving.h"

namespace gsut::bindings {
namespace {

// As three numbers: Julier and Uhlmann's alpha, beta and kappa.
UnscentedOptions Options(double alpha, double beta, double kappa) { return {alpha, beta, kappa}; }

// The kernel's own splats as arrays, for tests: centers and extents (N, 2), covariances (N, 2, 2),
// depths and status (N,), float32. extents: half sides of the box around the cut-off ellipse;
// status: SplatStatus as a number, which says how far the ellipse may be trusted.
py::dict ProjectFloat(const py::object& gaussians, const Camera& camera, const py::object& pose,
                      double alpha, double beta, double kappa, double alpha_min) {
  const auto view = ConstGaussians<float>(gaussians);
  const Pose camera_from_world = ReadPose(pose);
  Splats splats;
  {
    const LongCall released;
    Project(view, camera, camera_from_world, Options(alpha, beta, kappa), {alpha_min, 0.0},
            &splats);
  }
  const py::ssize_t n = static_cast<py::ssize_t>(view.size);
  // Columns of the kernel become rows of arrays, without its padding.
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

// The references in double: centers, covariances, and whether there is a footprint.
template <class Compute>
py::dict ProjectDouble(const py::object& gaussians, Compute&& compute) {
  const auto view = ConstGaussians<double>(gaussians);
  const py::ssize_t n = static_cast<py::ssize_t>(view.size);
  py::array_t<double> centers({n, py::ssize_t{2}});
  py::array_t<double> covariances({n, py::ssize_t{2}, py::ssize_t{2}});
  py::array_t<std::uint8_t> valid(n);
  // Pointers first: arrays may not be touched once the GIL is released.
  double* centers_data = centers.mutable_data();
  double* covariances_data = covariances.mutable_data();
  std::uint8_t* valid_data = valid.mutable_data();
  {
    const LongCall released;
    compute(view, centers_data, covariances_data, valid_data);
  }
  py::dict out;
  out["centers"] = centers;
  out["covariances"] = covariances;
  out["valid"] = valid;
  return out;
}

// By sigma points, whose weights are the three numbers; see UnscentedOptions.
py::dict ProjectUnscented(const py::object& gaussians, const Camera& camera, const py::object& pose,
                          double alpha, double beta, double kappa) {
  const Pose camera_from_world = ReadPose(pose);
  return ProjectDouble(gaussians, [&](const GaussiansView<const double>& view, double* centers,
                                      double* covariances, std::uint8_t* valid) {
    ProjectReference(view, camera, camera_from_world, Options(alpha, beta, kappa), centers,
                     covariances, valid);
  });
}

// By the lens' derivative at the mean: a baseline that gsut.project compares with. It has no float
// kernel, since the renderer never uses it.
py::dict ProjectEwa(const py::object& gaussians, const Camera& camera, const py::object& pose) {
  const Pose camera_from_world = ReadPose(pose);
  return ProjectDouble(gaussians, [&](const GaussiansView<const double>& view, double* centers,
                                      double* covariances, std::uint8_t* valid) {
    ProjectEwaReference(view, camera, camera_from_world, centers, covariances, valid);
  });
}

// Each sigma point through the pose of the line that it falls on, in double: as ProjectUnscented,
// and `converged` (N,), false where a point did not settle on a line.
py::dict ProjectMotion(const py::object& gaussians, const Camera& camera,
                       const CameraMotion& motion, double alpha, double beta, double kappa) {
  py::array_t<std::uint8_t> converged(
      static_cast<py::ssize_t>(ConstGaussians<double>(gaussians).size));
  std::uint8_t* converged_data = converged.mutable_data();
  py::dict out =
      ProjectDouble(gaussians, [&](const GaussiansView<const double>& view, double* centers,
                                   double* covariances, std::uint8_t* valid) {
        ProjectMoving(view, camera, motion, Options(alpha, beta, kappa), centers, covariances,
                      valid, converged_data);
      });
  out["converged"] = converged;
  return out;
}

}  // namespace

// (N,) D^2, or the gauge's square, at which each has this alpha; 0: nowhere.
py::array_t<double> Cutoffs(const std::string& primitive, const std::string& response,
                            const py::array_t<double, py::array::c_style>& opacity_logits,
                            double alpha_min) {
  GaussiansView<const double> view;
  view.size = static_cast<std::int64_t>(opacity_logits.size());
  view.opacity_logits = opacity_logits.data();
  view.primitive = PrimitiveNamed(primitive);
  view.response = ResponseNamed(response);
  py::array_t<double> out(opacity_logits.size());
  for (std::int64_t i = 0; i < view.size; ++i) {
    out.mutable_at(i) = std::max(CutoffOf(view, i, FootprintRule{alpha_min}), 0.0);
  }
  return out;
}

void BindProjection(py::module_& m) {
  m.def("compute_cutoffs", &Cutoffs, py::arg("primitive"), py::arg("response"),
        py::arg("opacity_logits"), py::arg("alpha_min"));
  m.def("project_moving", &ProjectMotion, py::arg("gaussians"), py::arg("camera"),
        py::arg("motion"), py::arg("alpha"), py::arg("beta"), py::arg("kappa"));
  m.def("project", &ProjectFloat, py::arg("gaussians"), py::arg("camera"),
        py::arg("camera_from_world"), py::arg("alpha"), py::arg("beta"), py::arg("kappa"),
        py::arg("alpha_min"));
  m.def("project_reference", &ProjectUnscented, py::arg("gaussians"), py::arg("camera"),
        py::arg("camera_from_world"), py::arg("alpha"), py::arg("beta"), py::arg("kappa"));
  m.def("project_ewa_reference", &ProjectEwa, py::arg("gaussians"), py::arg("camera"),
        py::arg("camera_from_world"));
}

}  // namespace gsut::bindings
