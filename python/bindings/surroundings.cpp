// Binds the colour of what surrounds an image's open pixels.
#include <pybind11/pybind11.h>

#include "bindings/arrays.h"
#include "bindings/module.h"
#include "gsut/raster/surroundings.h"

namespace gsut::bindings {
namespace {

// (H, W, 3) colours behind the open pixels of an image, from its alpha and the pixels that have a
// ray; None where no pixel is open.
py::object Surroundings(const py::object& image, const py::object& alpha, const py::object& valid) {
  const auto shares = ReadArray<float>(alpha, "alpha", {kAny, kAny});
  const std::int64_t height = shares.shape(0), width = shares.shape(1);
  const auto colors = ReadArray<float>(image, "image", {height, width, 3});
  const auto rays = ReadArray<std::uint8_t>(valid, "valid", {height, width});
  py::array_t<float> behind({height, width, std::int64_t{3}});
  float* const out = behind.mutable_data();
  bool open = false;
  {
    const py::gil_scoped_release released;
    open = height > 0 && width > 0 &&
           ComputeSurroundings(static_cast<int>(width), static_cast<int>(height), colors.data(),
                               shares.data(), rays.data(), out);
  }
  if (!open) return py::none();
  return behind;
}

}  // namespace

void BindSurroundings(py::module_& m) {
  m.def("compute_surroundings", &Surroundings, py::arg("image"), py::arg("alpha"),
        py::arg("valid"));
}

}  // namespace gsut::bindings
