// Binds what gsut/loss says of the pixels of an image one by one: its errors, and which are left
// out.
//
// A training may use either after the loss of a step: trim_gradient against what moved in one
// photograph, pixel_errors where errors decide on growth.
#include <pybind11/pybind11.h>

#include <cstdint>

#include "bindings/arrays.h"
#include "bindings/module.h"
#include "gsut/loss/photometric.h"
#include "gsut/loss/pixel_errors.h"
#include "gsut/loss/trim.h"

namespace gsut::bindings {

// Both take the image as it was rendered, without a copy, and the gradient array of the loss: a
// zero in it is how a pixel that does not count is known here.
void BindLossPixels(py::module_& m) {
  m.def(
      "trim_gradient",
      [](const PhotometricTarget& target, const py::object& image, const py::object& gradient) {
        const float* pixels =
            ConstData<float>(image, "image", {target.height(), target.width(), 3});
        float* out = MutableData<float>(gradient, "gradient", {target.height(), target.width(), 3});
        const py::gil_scoped_release release;
        return TrimGradient(target, pixels, {}, out);
      },
      py::arg("target"), py::arg("image"), py::arg("gradient"), R"doc(
Sets the gradient to zero where an area of the photograph does not belong to the scene.

A pixel differs if its error is more than 5 times the photograph's median error; where most of the
15 x 15 pixels around a pixel differ, its gradient becomes zero.

Args:
    target: the photograph, in its light.
    image: (H, W, 3) float32, C-contiguous: the rendered image.
    gradient: (H, W, 3) float32, changed in place.

Returns:
    Number of pixels.

Source: Sabour et al., "RobustNeRF", 2023, section 3.3, with the median for its quantile.
)doc");

  // A map of errors, into the caller's array.
  m.def(
      "pixel_errors",
      [](const PhotometricTarget& target, const py::object& image, const py::object& gradient,
         const py::object& errors) {
        const std::int64_t h = target.height(), w = target.width();
        const float* pixels = ConstData<float>(image, "image", {h, w, 3});
        const float* g = ConstData<float>(gradient, "gradient", {h, w, 3});
        float* out = MutableData<float>(errors, "errors", {h, w});
        const py::gil_scoped_release release;
        PixelErrors(target, pixels, g, out);
      },
      py::arg("target"), py::arg("image"), py::arg("gradient"), py::arg("errors"), R"doc(
Writes the mean absolute difference of the channels between an image and its photograph, each
channel of which is first brought to the brightness that fits the image best.

Args:
    target: the photograph, in its light.
    image: (H, W, 3) float32, C-contiguous: the rendered image.
    gradient: (H, W, 3) float32, of the loss to it: where it is 0 the pixel does not count.
    errors: (H, W) float32, overwritten; 0 where the pixel does not count.
)doc");
}

}  // namespace gsut::bindings
