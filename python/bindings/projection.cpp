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
#include "gsut/base/stopwatch.h"
#include "gsut/projection/footprint.h"
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

// The unscented transform in double: centers, covariances, and whether there is a footprint.
py::dict ProjectDouble(const py::object& gaussians, const Camera& camera, const py::object& pose,
                       double alpha, double beta, double kappa) {
  const auto view = ConstGaussians<double>(gaussians);
  const Pose camera_from_world = ReadPose(pose);
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
    ProjectReference(view, camera, camera_from_world, Options(alpha, beta, kappa), centers_data,
                     covariances_data, valid_data);
  }
  py::dict out;
  out["centers"] = centers;
  out["covariances"] = covariances;
  out["valid"] = valid;
  return out;
}

// Columns of N footprints as arrays of T.
// centers (N, 2), covariances (N, 2, 2), boxes (N, 4) as low u, low v, high u, high v, and status
// (N,), a FootprintStatus as a number; NaN where there is none.
template <class T>
py::dict FootprintArrays(const Footprints<T>& found) {
  const py::ssize_t n = static_cast<py::ssize_t>(found.size);
  py::array_t<T> centers({n, py::ssize_t{2}}), boxes({n, py::ssize_t{4}});
  py::array_t<T> covariances({n, py::ssize_t{2}, py::ssize_t{2}});
  py::array_t<std::uint8_t> status(n);
  T* center = centers.mutable_data();
  T* box = boxes.mutable_data();
  T* covariance = covariances.mutable_data();
  for (py::ssize_t i = 0; i < n; ++i) {
    const std::size_t j = static_cast<std::size_t>(i);
    center[2 * i] = found.u[j];
    center[2 * i + 1] = found.v[j];
    covariance[4 * i] = found.cov_uu[j];
    covariance[4 * i + 1] = covariance[4 * i + 2] = found.cov_uv[j];
    covariance[4 * i + 3] = found.cov_vv[j];
    box[4 * i] = found.low_u[j];
    box[4 * i + 1] = found.low_v[j];
    box[4 * i + 2] = found.high_u[j];
    box[4 * i + 3] = found.high_v[j];
    status.mutable_data()[i] = static_cast<std::uint8_t>(found.status[j]);
  }
  py::dict out;
  out["centers"] = centers;
  out["covariances"] = covariances;
  out["boxes"] = boxes;
  out["status"] = status;
  return out;
}

// Keeps the arrays of footprints from call to call, so that a timing does not count their making.
class Footprinter {
 public:
  Footprinter(int method, const std::array<double, 3>& unscented, double alpha_min) {
    // By number: the package has the names.
    if (method < 0 || method > static_cast<int>(ProjectionMethod::kSilhouette)) {
      throw InputError("projection method " + std::to_string(method) + " is unknown");
    }
    options_.method = static_cast<ProjectionMethod>(method);
    options_.unscented = Options(unscented[0], unscented[1], unscented[2]);
    options_.rule.alpha_min = alpha_min;
  }

  // Only FindFootprints is timed: neither the checks of the arrays nor the copies out of them.
  // Finds them and returns (wall, processor) seconds.
  py::tuple Find(const py::object& gaussians, const Camera& camera, const py::object& pose) {
    const auto view = ConstGaussians<float>(gaussians);
    const Pose camera_from_world = ReadPose(pose);
    const LongCall released;
    Stopwatch watch;
    FindFootprints(view, camera, camera_from_world, options_, &found_);
    const StageTime time = watch.Lap("project");
    // The tuple needs the GIL again, while `released` still holds it off.
    const py::gil_scoped_acquire acquire;
    return py::make_tuple(time.wall_seconds, time.cpu_seconds);
  }

  // Copies, so that the next find leaves them as they are.
  py::dict Arrays() const { return FootprintArrays(found_); }

  // The same in double, by the scalar code; nothing is kept.
  py::dict Reference(const py::object& gaussians, const Camera& camera,
                     const py::object& pose) const {
    const auto view = ConstGaussians<double>(gaussians);
    const Pose camera_from_world = ReadPose(pose);
    Footprints<double> found;
    {
      const LongCall released;
      FindFootprintsReference(view, camera, camera_from_world, options_, &found);
    }
    return FootprintArrays(found);
  }

 private:
  FootprintOptions options_;
  Footprints<float> found_;
};

// Each sigma point through the pose of the line that it falls on, in double: as ProjectDouble, and
// `converged` (N,), false where a point did not settle on a line.
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
    const LongCall released;
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

// (N,) D^2, or the gauge's square, at which each has this alpha; 0: nowhere.
py::array_t<double> Cutoffs(const std::string& primitive, const std::string& response,
                            const py::array_t<double, py::array::c_style>& opacity_logits,
                            const py::object& shapes, double alpha_min) {
  GaussiansView<const double> view;
  view.size = static_cast<std::int64_t>(opacity_logits.size());
  view.opacity_logits = opacity_logits.data();
  view.primitive = PrimitiveNamed(primitive);
  view.response = ResponseNamed(response);
  view.shapes = OptionalData<double>(shapes, "shapes", {view.size});
  py::array_t<double> out(opacity_logits.size());
  for (std::int64_t i = 0; i < view.size; ++i) {
    out.mutable_at(i) = std::max(CutoffOf(view, i, FootprintRule{alpha_min}), 0.0);
  }
  return out;
}

void BindProjection(py::module_& m) {
  m.def("compute_cutoffs", &Cutoffs, py::arg("primitive"), py::arg("response"),
        py::arg("opacity_logits"), py::arg("shapes"), py::arg("alpha_min"));
  m.def("project_moving", &ProjectMotion, py::arg("gaussians"), py::arg("camera"),
        py::arg("motion"), py::arg("alpha"), py::arg("beta"), py::arg("kappa"));
  m.def("project", &ProjectFloat, py::arg("gaussians"), py::arg("camera"),
        py::arg("camera_from_world"), py::arg("alpha"), py::arg("beta"), py::arg("kappa"),
        py::arg("alpha_min"));
  m.def("project_reference", &ProjectDouble, py::arg("gaussians"), py::arg("camera"),
        py::arg("camera_from_world"), py::arg("alpha"), py::arg("beta"), py::arg("kappa"));
  py::class_<Footprinter>(m, "Footprinter", "Footprints by one method, with its buffers.")
      .def(py::init<int, const std::array<double, 3>&, double>(), py::arg("method"),
           py::arg("unscented"), py::arg("alpha_min"))
      .def("find", &Footprinter::Find, py::arg("gaussians"), py::arg("camera"),
           py::arg("camera_from_world"))
      .def("arrays", &Footprinter::Arrays)
      .def("reference", &Footprinter::Reference, py::arg("gaussians"), py::arg("camera"),
           py::arg("camera_from_world"));
}

}  // namespace gsut::bindings
