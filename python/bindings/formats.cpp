// Binds gsut/formats: PLY files.
//
// Only PLY is read and written in C++, where the time goes; the other formats are Python's.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>

#include "bindings/arrays.h"
#include "bindings/module.h"
#include "gsut/formats/ply.h"

namespace gsut::bindings {
namespace {

// The header first, which says how many rows and harmonics there are; then arrays of just that
// size, read into without a copy and without the GIL. Returns the public fields, how many rows are
// not finite, and the origin that was subtracted (0 where the file has none).
// path: bytes, for a name need not be UTF-8.
py::tuple ReadPly(const py::bytes& path) {
  PlyGaussianReader reader{std::string(path)};
  const auto n = static_cast<py::ssize_t>(reader.size());
  const py::ssize_t k = reader.sh_coefficients();
  auto means = NewArray<float>({n, 3});
  auto quats = NewArray<float>({n, 4});
  auto log_scales = NewArray<float>({n, 3});
  auto opacity_logits = NewArray<float>({n});
  auto sh = NewArray<float>({n, k, 3});
  GaussiansView<float> view = {
      reader.size(),        reader.sh_coefficients(),  means.mutable_data(),
      quats.mutable_data(), log_scales.mutable_data(), opacity_logits.mutable_data(),
      sh.mutable_data()};
  std::int64_t not_finite = 0;
  {
    const py::gil_scoped_release release;
    not_finite = reader.Read(view);
  }
  // Coordinates far from zero keep their digits: floats about an origin in double.
  const auto& [x, y, z] = reader.origin();
  return py::make_tuple(means, quats, log_scales, opacity_logits, sh, not_finite,
                        py::make_tuple(x, y, z));
}

// Written to a temporary file beside it and moved, so that an interrupted call leaves the old one.
void WritePlyFile(const py::bytes& path_bytes, const py::object& gaussians,
                  const std::vector<std::string>& comments, bool surfels) {
  const std::string path = path_bytes;
  const GaussiansView<const float> view = ConstGaussians<float>(gaussians);
  const py::gil_scoped_release release;
  WritePly(path, view, comments, surfels);
}

// Colours come as bytes: files with 16-bit or float colours are scaled by their own full value,
// which is returned where it is not one of the usual.
py::tuple ReadPoints(const py::bytes& path_bytes) {
  const std::string path = path_bytes;
  PlyPoints points;
  {
    const py::gil_scoped_release release;
    points = ReadPlyPoints(path);
  }
  const auto n = static_cast<py::ssize_t>(points.positions.size() / 3);
  auto positions = NewArray<double>({n, 3});
  auto colors = NewArray<std::uint8_t>({n, 3});
  // Positions stay double: clouds may lie at coordinates of a map.
  std::copy(points.positions.begin(), points.positions.end(), positions.mutable_data());
  std::copy(points.colors.begin(), points.colors.end(), colors.mutable_data());
  return py::make_tuple(positions, colors, points.unusual_white);
}

}  // namespace

void BindFormats(pybind11::module_& m) {
  m.def("read_ply", &ReadPly, py::arg("path"),
        "Means, quats, log_scales, opacity_logits, sh (float32), the number of rows that are not "
        "finite, and what was taken off the means (3 numbers), of a PLY file.");
  m.def("write_ply", &WritePlyFile, py::arg("path"), py::arg("gaussians"),
        py::arg("comments") = std::vector<std::string>(), py::arg("surfels") = false,
        "Writes float32 Gaussians as a binary PLY file, atomically; surfels: without scale_2.");
  m.def("read_ply_points", &ReadPoints, py::arg("path"),
        "Positions (N,3) float64, colours (N,3) uint8 of a PLY point cloud, and the file's value "
        "of full brightness where it is an unusual one, else 0.");
}

}  // namespace gsut::bindings
