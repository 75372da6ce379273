// Binds gsut/formats: PLY files.
//
// Only PLY is read and written in C++, where the time goes; the other formats are Python's.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#ifdef _WIN32
#include <io.h>
#else
#include <unistd.h>
#endif

#include <algorithm>
#include <cerrno>
#include <fstream>

#include "bindings/arrays.h"
#include "bindings/module.h"
#include "gsut/formats/ply.h"
#include "gsut/formats/ply_rows.h"

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

// Writes to an open file, which Python makes whole: see gsut.files. announced: see PutPly.
void WritePlyRows(int descriptor, const py::object& gaussians,
                  const std::vector<std::string>& comments, bool surfels, std::int64_t announced) {
  const GaussiansView<const float> view = ConstGaussians<float>(gaussians);
  int failed = 0;
  {
    const py::gil_scoped_release release;
    PutPly(view, comments, surfels, announced, [&](const char* data, std::size_t size) {
      // A write may take a part only, and a signal may end it before its first byte.
      while (size > 0 && failed == 0) {
        const auto done = write(descriptor, data, static_cast<unsigned>(size));
        if (done < 0 && errno != EINTR) failed = errno;
        if (done <= 0) continue;
        data += done;
        size -= static_cast<std::size_t>(done);
      }
    });
  }
  if (failed == 0) return;
  // As Python's own writers fail: gsut.files makes the sentence that names the file.
  errno = failed;
  PyErr_SetFromErrno(PyExc_OSError);
  throw py::error_already_set();
}

// What a type of PLY is to numpy, without the byte order.
const char* NumpyName(PlyType type) {
  static constexpr const char* kNames[] = {"i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"};
  return kNames[static_cast<int>(type)];
}

// The one parser of headers, also for the layouts that only Python reads.
py::tuple ReadHeader(const py::bytes& path_bytes) {
  const std::string path = path_bytes;
  std::ifstream stream = OpenToRead(path);
  const PlyHeader header = ReadPlyHeader(stream, path);
  CheckPlySize(stream, path, header);
  py::list elements, comments;
  for (const PlyElement& element : header.elements) {
    py::list properties;
    for (const PlyProperty& property : element.properties) {
      const char* length = property.is_list ? NumpyName(property.count_type) : "";
      properties.append(py::make_tuple(property.name, NumpyName(property.type), length));
    }
    elements.append(py::make_tuple(element.name, element.count, properties));
  }
  for (const std::string& comment : header.comments) comments.append(py::str(comment));
  static constexpr const char* kOrders[] = {"", "<", ">"};
  return py::make_tuple(kOrders[static_cast<int>(header.format)], elements, comments,
                        static_cast<std::int64_t>(stream.tellg()));
}

// Doubles, as clouds may lie at coordinates of a map.
py::array_t<double> ReadColumns(const py::bytes& path, const std::vector<std::string>& names) {
  std::vector<double> numbers;
  {
    const std::string name = path;
    const py::gil_scoped_release release;
    numbers = ReadPlyColumns(name, names);
  }
  const std::size_t count = std::max<std::size_t>(names.size(), 1);
  auto out = NewArray<double>(
      {static_cast<std::int64_t>(numbers.size() / count), static_cast<std::int64_t>(names.size())});
  std::copy(numbers.begin(), numbers.end(), out.mutable_data());
  return out;
}

}  // namespace

void BindFormats(pybind11::module_& m) {
  m.def("read_ply", &ReadPly, py::arg("path"),
        "Means, quats, log_scales, opacity_logits, sh (float32), the number of rows that are not "
        "finite, and what was taken off the means (3 numbers), of a PLY file.");
  m.def("read_ply_header", &ReadHeader, py::arg("path"),
        "Byte order (\"\": text), elements (name, count, properties (name, numpy's type, that of a "
        "list's length or \"\")), comments and the offset of the data, of a PLY file.");
  m.def("write_ply", &WritePlyRows, py::arg("descriptor"), py::arg("gaussians"),
        py::arg("comments"), py::arg("surfels"), py::arg("announced"),
        "Writes float32 Gaussians as binary PLY to an open file; surfels: without scale_2; "
        "announced: the number of Gaussians in the header, negative: without a header.");
  m.def("read_ply_columns", &ReadColumns, py::arg("path"), py::arg("names"),
        "These properties of the element \"vertex\", (N, names) float64, of a PLY file.");
}

}  // namespace gsut::bindings
