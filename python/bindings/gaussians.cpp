// Binds gsut/gaussians: harmonics and seeding.
//
// Gaussians are any object with the five arrays (arrays.h); the core sees views of them and never
// owns one. Functions that make new values take the array to write into.
#include <pybind11/pybind11.h>

#include <cmath>

#include "bindings/arrays.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/harmonics.h"
#include "gsut/gaussians/facing_axes.h"
#include "gsut/gaussians/seed.h"
#include "gsut/gaussians/surfels.h"

namespace gsut::bindings {
namespace {

// Rows a task: colours take little time each.
constexpr std::int64_t kChunkRows = 1024;

// In one thread: for tests and tools. Directions are taken as unit vectors, unchecked.
py::array_t<double> Basis(int degree, const py::object& directions_object) {
  if (degree < 0 || degree > kMaxShDegree) {
    throw InputError("degree is " + std::to_string(degree) + "; give 0 to 3");
  }
  const auto directions = ReadArray<double>(directions_object, "directions", {kAny, 3});
  const int k = NumShCoefficients(degree);
  auto basis = NewArray<double>({directions.shape(0), k});
  const double* in = directions.data();
  double* out = basis.mutable_data();
  for (py::ssize_t i = 0; i < directions.shape(0); ++i) {
    HarmonicsBasis(degree, in[3 * i], in[3 * i + 1], in[3 * i + 2], out + i * k);
  }
  return basis;
}

// The colour as renderers have it, with the degree from the shape of sh; rows are independent, so
// that chunks may run on any thread.
py::array_t<double> Colors(const py::object& directions_object, const py::object& sh_object) {
  const auto directions = ReadArray<double>(directions_object, "directions", {kAny, 3});
  const auto sh = ReadArray<double>(sh_object, "sh", {directions.shape(0), kAny, 3});
  const py::ssize_t k = sh.shape(1);
  const int degree = ShDegree(k);
  if (degree < 0) {
    throw InputError("sh has " + std::to_string(k) + " coefficients; give 1, 4, 9 or 16");
  }
  auto colors = NewArray<double>({directions.shape(0), 3});
  const double* in = directions.data();
  const double* coefficients = sh.data();
  double* out = colors.mutable_data();
  const LongCall released;
  ParallelFor(directions.shape(0), kChunkRows, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      EvalHarmonics(degree, in + 3 * i, coefficients + 3 * k * i, out + 3 * i);
    }
  });
  return colors;
}

// Fills arrays that the caller made, one Gaussian a point: sizes from the nearest neighbours, grey
// where no colour is known is the caller's choice. In place, so without an interrupt half-way.
void Seed(const py::object& points_object, const py::object& colors_object,
          const py::object& gaussians, double scale_factor, double opacity) {
  const GaussiansView<float> out = MutableGaussians<float>(gaussians);
  const auto points = ReadArray<double>(points_object, "points", {out.size, 3});
  const auto colors = ReadArray<double>(colors_object, "colors", {out.size, 3});
  // The other options keep their defaults, which seed.h gives a reason for.
  SeedOptions options;
  options.scale_factor = scale_factor;
  options.opacity = opacity;
  const double* point_data = points.data();
  const double* color_data = colors.data();
  const py::gil_scoped_release release;
  SeedFromPoints(point_data, color_data, options, out);
}

// Judged by the means; the checks of the view refuse arrays of mixed dtypes.
bool IsDouble(const py::object& gaussians) {
  return py::isinstance<py::array_t<double>>(gaussians.attr("means"));
}

// sh (N, 1, 3) is written, as a colour of degree 0 that any renderer draws: normals are blended by
// the same kernels as colours, and their gradients come back through FacingAxesBackwardAs.
template <class T>
void FacingAxesAs(const py::object& gaussians, const std::array<double, 3>& center,
                  const py::object& sh) {
  const auto view = ConstGaussians<T>(gaussians);
  T* out = MutableData<T>(sh, "sh", {view.size, 1, 3});
  const py::gil_scoped_release release;
  FacingAxes(view, center.data(), out);
}

// Adds to what the gradients hold: the image's own come first.
template <class T>
void FacingAxesBackwardAs(const py::object& gaussians, const std::array<double, 3>& center,
                          const py::object& dsh, const py::object& gradients, double flatten) {
  const auto view = ConstGaussians<T>(gaussians);
  const T* slopes = ConstData<T>(dsh, "dsh", {view.size, 1, 3});
  const auto out = MutableGaussians<T>(gradients);
  if (out.size != view.size) throw InputError("gradients must be shaped like the Gaussians");
  const py::gil_scoped_release release;
  FacingAxesBackward(view, center.data(), slopes, out.quats);
  if (flatten > 0.0) FlattenGradient(view, flatten, out.log_scales);
}

}  // namespace

void BindGaussians(pybind11::module_& m) {
  // Of the third scale of a surfel, as a logarithm: files of surfels leave it out.
  m.attr("SURFEL_LOG_THICKNESS") = kSurfelLogThickness;
  m.def(
      "list_primitives",
      [] {
        py::dict found;
        for (const std::string& name : PrimitiveNames()) {
          const Primitive primitive = PrimitiveNamed(name);
          found[py::str(name)] = py::make_tuple(WidthOf(primitive), IsFlat(primitive));
        }
        return found;
      },
      "Primitive -> its width at half its response over a Gaussian's of the same scales, and "
      "whether it is flat.");
  m.def("harmonics_basis", &Basis, py::arg("degree"), py::arg("directions"),
        "Basis values (N,K) of unit directions (N,3), in double.");
  m.def("eval_harmonics", &Colors, py::arg("directions"), py::arg("sh"),
        "Colours (N,3) = max(0, 0.5 + basis . sh) of unit directions (N,3) and sh (N,K,3), in "
        "double.");
  m.def("seed_from_points", &Seed, py::arg("points"), py::arg("colors"), py::arg("gaussians"),
        py::arg("scale_factor"), py::arg("opacity"),
        "Fills float32 Gaussians from points (N,3) and colours (N,3) in [0, 1].");
  // Two names, each for both dtypes: lambdas choose by the arrays that arrive.
  m.def(
      "facing_axes",
      [](const py::object& gaussians, const std::array<double, 3>& center, const py::object& sh) {
        IsDouble(gaussians) ? FacingAxesAs<double>(gaussians, center, sh)
                            : FacingAxesAs<float>(gaussians, center, sh);
      },
      py::arg("gaussians"), py::arg("center"), py::arg("sh"),
      "Writes the shortest axes, facing the centre, as harmonics (N,1,3) of colours 0.5 + 0.5 "
      "axis.");
  m.def(
      "facing_axes_backward",
      [](const py::object& gaussians, const std::array<double, 3>& center, const py::object& dsh,
         const py::object& gradients, double flatten) {
        IsDouble(gaussians)
            ? FacingAxesBackwardAs<double>(gaussians, center, dsh, gradients, flatten)
            : FacingAxesBackwardAs<float>(gaussians, center, dsh, gradients, flatten);
      },
      py::arg("gaussians"), py::arg("center"), py::arg("dsh"), py::arg("gradients"),
      py::arg("flatten") = 0.0,
      "Adds the gradients through facing_axes to the quats, and those of flatten x mean of the "
      "shortest scale to the log_scales.");
}

}  // namespace gsut::bindings
