// Binds gsut/loss.
//
// The part of the loss that depends on the photograph alone is an object, made once a photograph;
// calls then take the rendered image without a copy. Gradients go into arrays of the caller.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "gsut/loss/light.h"
#include "gsut/loss/metrics.h"
#include "gsut/loss/photometric.h"
#include "gsut/loss/reference.h"
#include "gsut/loss/surface.h"

namespace gsut::bindings {
namespace {

template <class T>
using CArray = py::array_t<T, py::array::c_style | py::array::forcecast>;

py::array AnyArray(const py::handle& object, const char* name) {
  py::array array = py::array::ensure(object);
  if (array) return array;
  PyErr_Clear();
  throw InputError(std::string(name) + " is not an array of numbers");
}

// An optional (H, W) mask of bool or integers; data() is null without one.
class MaskArray {
 public:
  MaskArray(const py::object& mask, std::int64_t height, std::int64_t width) {
    if (mask.is_none()) return;
    const py::array array = AnyArray(mask, "mask");
    const char kind = array.dtype().kind();
    if (kind != 'b' && kind != 'u' && kind != 'i') {
      throw InputError("mask must be of bool or integers (non-zero where a pixel counts), found " +
                       std::string(py::str(array.dtype())));
    }
    CheckShape(array, "mask", {height, width});
    bytes_ = CArray<std::uint8_t>::ensure(array.attr("__ne__")(0));
  }
  const std::uint8_t* data() const { return bytes_ ? bytes_->data() : nullptr; }

 private:
  std::optional<CArray<std::uint8_t>> bytes_;
};

// 8-bit and floating point only: other whole numbers could be levels of 255 or of 65535.
std::unique_ptr<PhotometricTarget> MakeTarget(const py::object& image, const py::object& mask,
                                              const std::string& window_rule,
                                              bool keep_statistics) {
  const PhotometricOptions options{ParseWindowRule(window_rule), keep_statistics};
  const py::array array = AnyArray(image, "image");
  CheckShape(array, "image", {kAny, kAny, 3});
  const std::int64_t height = array.shape(0), width = array.shape(1);
  const MaskArray mask_array(mask, height, width);
  // The image is copied: a view's array may be a slice of a file that is closed later.
  const std::string dtype = py::str(array.dtype());
  if (dtype == "uint8") {
    const auto bytes = ReadArray<std::uint8_t>(array, "image", {height, width, 3});
    const py::gil_scoped_release release;
    return std::make_unique<PhotometricTarget>(bytes.data(), height, width, mask_array.data(),
                                               options);
  }
  if (array.dtype().kind() != 'f') {
    throw InputError("image must be uint8, or floating point in [0, 1], found " + dtype);
  }
  const auto floats = ReadArray<float>(array, "image", {height, width, 3});
  const py::gil_scoped_release release;
  return std::make_unique<PhotometricTarget>(floats.data(), height, width, mask_array.data(),
                                             options);
}

// The render as the loss reads it. Only a double or strided image is copied; whole numbers, which
// would be taken for colours 255 times too bright, are refused.
CArray<float> ReadRender(const py::object& image, const PhotometricTarget& target) {
  const py::array array = AnyArray(image, "image");
  if (array.dtype().kind() != 'f') {
    throw InputError("image must be floating point, as it was rendered, found " +
                     std::string(py::str(array.dtype())));
  }
  return ReadArray<float>(array, "image", {target.height(), target.width(), 3});
}

// Into the caller's array where one is given: a training reuses it for every step.
py::tuple Loss(const PhotometricTarget& target, const py::object& image, const py::object& grad_out,
               double ssim_weight) {
  const auto rendered = ReadRender(image, target);
  const float* pixels = rendered.data();
  py::object gradient = grad_out;
  if (gradient.is_none()) gradient = NewArray<float>({target.height(), target.width(), 3});
  float* gradient_pixels =
      MutableData<float>(gradient, "grad_out", {target.height(), target.width(), 3});
  if (gradient_pixels == pixels) throw InputError("grad_out must not be the image itself");
  PhotometricValue value;
  {
    const py::gil_scoped_release release;
    value = PhotometricLoss(target, pixels, ssim_weight, gradient_pixels);
  }
  return py::make_tuple(value.loss, gradient);
}

// Loss, L1 and 1 - SSIM apart, for reports; no gradient is formed.
py::tuple Value(const PhotometricTarget& target, const py::object& image, double ssim_weight) {
  const auto rendered = ReadRender(image, target);
  const float* pixels = rendered.data();
  PhotometricValue value;
  {
    const py::gil_scoped_release release;
    value = PhotometricLoss(target, pixels, ssim_weight, nullptr);
  }
  return py::make_tuple(value.loss, value.l1, value.dssim);
}

py::tuple LossReference(const py::object& target, const py::object& image, const py::object& mask,
                        double ssim_weight, const std::string& window_rule) {
  const WindowRule rule = ParseWindowRule(window_rule);
  const auto y = ReadArray<double>(target, "target", {kAny, kAny, 3});
  const auto x = ReadArray<double>(image, "image", {y.shape(0), y.shape(1), 3});
  const MaskArray mask_array(mask, y.shape(0), y.shape(1));
  py::array_t<double> gradient = NewArray<double>({y.shape(0), y.shape(1), 3});
  double* const gradient_pixels = gradient.mutable_data();
  const std::int64_t height = y.shape(0), width = y.shape(1);
  PhotometricValue value;
  {
    const LongCall released;
    value = PhotometricLossReference(y.data(), x.data(), mask_array.data(), height, width, rule,
                                     ssim_weight, gradient_pixels);
  }
  return py::make_tuple(value.loss, gradient);
}

// Metrics are of any numbers, converted to double; masked pixels may hold NaN.
double PsnrOfArrays(const py::object& a, const py::object& b, const py::object& mask,
                    const py::object& weights) {
  const auto x = ReadArray<double>(a, "a", {kAny, kAny, 3});
  const auto y = ReadArray<double>(b, "b", {x.shape(0), x.shape(1), 3});
  const MaskArray mask_array(mask, x.shape(0), x.shape(1));
  std::optional<CArray<double>> weight_array;
  if (!weights.is_none()) {
    weight_array = ReadArray<double>(weights, "weights", {x.shape(0), x.shape(1)});
  }
  const std::int64_t height = x.shape(0), width = x.shape(1);
  const LongCall released;
  return Psnr(x.data(), y.data(), mask_array.data(), weight_array ? weight_array->data() : nullptr,
              height, width);
}

double SsimOfArrays(const py::object& a, const py::object& b, const py::object& mask,
                    const std::string& window_rule) {
  const WindowRule rule = ParseWindowRule(window_rule);
  const auto x = ReadArray<double>(a, "a", {kAny, kAny, 3});
  const auto y = ReadArray<double>(b, "b", {x.shape(0), x.shape(1), 3});
  const MaskArray mask_array(mask, x.shape(0), x.shape(1));
  const std::int64_t height = x.shape(0), width = x.shape(1);
  const LongCall released;
  return Ssim(x.data(), y.data(), mask_array.data(), height, width, rule);
}

// May recompute statistics, so that other Python threads go on.
void SetLight(PhotometricTarget& target, const std::array<float, 3>& inverse_gain,
              const std::shared_ptr<FalloffPlane>& inverse_falloff) {
  const py::gil_scoped_release release;
  target.SetLight(inverse_gain, inverse_falloff);
}

py::array_t<double> LightSumsOf(const PhotometricTarget& target, const py::object& image,
                                const py::object& bins, int num_bins) {
  const float* pixels = ConstData<float>(image, "image", {target.height(), target.width(), 3});
  const std::uint8_t* of_pixels = nullptr;
  if (!bins.is_none()) {
    of_pixels = ConstData<std::uint8_t>(bins, "bins", {target.height(), target.width()});
  }
  if (num_bins < 1) throw InputError("num_bins must be at least 1");
  std::vector<LightSums> sums(static_cast<std::size_t>(num_bins));
  {
    const py::gil_scoped_release release;
    SumLight(target, pixels, of_pixels, num_bins, sums.data());
  }
  py::array_t<double> out = NewArray<double>({2, num_bins, 3});
  // One array of two planes: sums of T C, then of C^2.
  double* const tc = out.mutable_data();
  double* const cc = tc + 3 * sums.size();
  for (std::size_t b = 0; b < sums.size(); ++b) {
    std::copy_n(sums[b].tc, 3, tc + 3 * b);
    std::copy_n(sums[b].cc, 3, cc + 3 * b);
  }
  return out;
}

void BindTargets(py::module_& m) {
  py::class_<FalloffPlane, std::shared_ptr<FalloffPlane>>(m, "FalloffPlane", R"doc(
Factors of a photograph's pixels, shared by the targets of one camera.

Args:
    values: (H, W, 3) float32, positive.

Raises:
    InputError: values that are not positive and finite.
)doc")
      .def(py::init([](const py::object& values) {
             const auto plane = ReadArray<float>(values, "values", {kAny, kAny, 3});
             const float* data = plane.data();
             return std::make_shared<FalloffPlane>(std::vector<float>(data, data + plane.size()));
           }),
           py::arg("values"));
  py::class_<PhotometricTarget>(m, "PhotometricTarget", R"doc(
One training image, with all of the photometric loss that does not depend on the rendered image.

Args:
    image: (H, W, 3) uint8, or floating point in [0, 1]; copied.
    mask: (H, W) bool or integers, non-zero where a pixel counts; None: all count. A masked pixel
        has no loss, and the image may hold anything there.
    window_rule: which SSIM windows count. "partial": every unmasked pixel, its 11 x 11 window cut
        to the unmasked pixels and renormalised; reaches the rim of a fisheye's circle. "valid":
        only pixels whose whole window lies inside image and mask; where there is none it falls
        back to "partial". The same number where the whole window lies inside.
    keep_statistics: keep the target's blurred mean and variance (24 bytes a pixel), which saves
        about a seventh of the time of every call. Same bits either way.

Raises:
    InputError: shapes disagree, a mask that leaves no pixel, values not finite or far outside
        [0, 1] at a pixel that counts, an unknown rule.
)doc")
      .def(py::init(&MakeTarget), py::arg("image"), py::arg("mask") = py::none(),
           py::arg("window_rule") = "partial", py::arg("keep_statistics") = false)
      .def_property_readonly("height", &PhotometricTarget::height, "Rows of the image.")
      .def_property_readonly("width", &PhotometricTarget::width, "Columns of the image.")
      .def_property_readonly("pixels", &PhotometricTarget::pixels,
                             "Number of unmasked pixels: L1 is averaged over them.")
      .def_property_readonly(
          "window_rule", [](const PhotometricTarget& t) { return WindowRuleName(t.window_rule()); },
          "The rule in use, after the fallback.")
      .def_property_readonly("nbytes", &PhotometricTarget::bytes, "Memory held, in bytes.")
      .def("set_light", &SetLight, py::arg("inverse_gain"), py::arg("inverse_falloff") = py::none(),
           R"doc(
States the light that the photograph was taken in, which images then know nothing of.

The loss compares the image with the photograph's values times these.

Args:
    inverse_gain: 3 factors, one a channel.
    inverse_falloff: a FalloffPlane of the photograph's size; None: 1 everywhere.

Raises:
    InputError: a gain that is not positive and finite, a plane of another size.
)doc")
      .def("light_sums", &LightSumsOf, py::arg("image"), py::arg("bins") = py::none(),
           py::arg("num_bins") = 1, R"doc(
Sums that tell the photograph's gain against an image: tc / cc is the least-squares gain.

Over unmasked pixels of every fourth row where the photograph is neither black nor saturated.

Args:
    image: (H, W, 3) float32, C-contiguous.
    bins: (H, W) uint8 below num_bins, such as rings of field angle; None: all 0.
    num_bins: number of bins B.

Returns:
    (2, B, 3): tc, sums of photograph (without `set_light`) times image, and cc, of image squared.

Raises:
    InputError: wrong shapes or dtypes, a bin that is not there.
)doc")
      .def("value", &Value, py::arg("image"), py::arg("ssim_weight") = kDefaultSsimWeight, R"doc(
Value of the loss without its gradient.

Returns:
    loss, l1, dssim: (1 - w) l1 + w dssim, the mean absolute difference, 1 - SSIM.
)doc");
}

// maps: the render by name, as an object would need nine arguments; all of T, none copied.
template <class T>
std::array<double, 3> SurfaceLossAs(const py::dict& maps, const std::array<double, 4>& weights,
                                    const py::object& dalpha, const py::object& ddepth,
                                    const py::object& ddistortion, const py::object& dnormals) {
  const py::array alpha = py::cast<py::array>(maps["alpha"]);
  CheckShape(alpha, "alpha", {kAny, kAny});
  const std::int64_t h = alpha.shape(0), w = alpha.shape(1);
  const auto plane = [&](const char* name) {
    return ConstData<T>(py::object(maps[name]), name, {h, w});
  };
  const auto vectors = [&](const char* name) {
    return ConstData<T>(py::object(maps[name]), name, {h, w, 3});
  };
  const SurfaceRender<T> render = {h,
                                   w,
                                   vectors("directions"),
                                   vectors("origins"),
                                   plane("alpha"),
                                   plane("depth"),
                                   plane("distortion"),
                                   vectors("normals"),
                                   OptionalData<T>(py::object(maps["known"]), "known", {h, w})};
  const SurfaceGradients<T> out = {MutableData<T>(dalpha, "dalpha", {h, w}),
                                   MutableData<T>(ddepth, "ddepth", {h, w}),
                                   MutableData<T>(ddistortion, "ddistortion", {h, w}),
                                   MutableData<T>(dnormals, "dnormals", {h, w, 3})};
  const py::gil_scoped_release release;
  const SurfaceTerms terms =
      SurfaceLoss(render, {weights[0], weights[1], weights[2], weights[3]}, out);
  return {terms.normal, terms.distortion, terms.known};
}

}  // namespace

void BindLoss(py::module_& m) {
  BindTargets(m);
  m.def("photometric_loss", &Loss, py::arg("target"), py::arg("image"),
        py::arg("grad_out") = py::none(), py::arg("ssim_weight") = kDefaultSsimWeight, R"doc(
Training loss (1 - w) L1 + w (1 - SSIM) and its gradient to the rendered image.

Args:
    target: the training image.
    image: (H, W, 3) floating point: the rendered image, not clamped; compared in float32.
    grad_out: (H, W, 3) float32 to overwrite with the gradient; None: a new array.
    ssim_weight: w in [0, 1].

Returns:
    loss, gradient: float and (H, W, 3) float32 dloss_dimage; 0 at masked pixels.

Raises:
    InputError: wrong shapes or dtypes, grad_out is image, ssim_weight outside [0, 1].

The same bits on any number of threads. Error against the double reference: loss 5e-7 relative,
gradient 2e-6 relative (L2), from 30 unmasked pixels on (1.7e-5 below).
Source: Kerbl et al., "3D Gaussian splatting", 2023, equation 7; SSIM of Wang et al., 2004.
)doc");

  m.def(
      "surface_loss",
      [](const py::dict& maps, const std::array<double, 4>& weights, const py::object& dalpha,
         const py::object& ddepth, const py::object& ddistortion, const py::object& dnormals) {
        return py::isinstance<py::array_t<double>>(maps["alpha"])
                   ? SurfaceLossAs<double>(maps, weights, dalpha, ddepth, ddistortion, dnormals)
                   : SurfaceLossAs<float>(maps, weights, dalpha, ddepth, ddistortion, dnormals);
      },
      py::arg("maps"), py::arg("weights"), py::arg("dalpha"), py::arg("ddepth"),
      py::arg("ddistortion"), py::arg("dnormals"), R"doc(
What training for surfaces asks of a render, and its gradients to the render's maps.

Args:
    maps: directions and origins (H, W, 3) of the rays, alpha, depth and distortion (H, W), normals
        (H, W, 3) of a render of facing_axes over 0.5, known (H, W) distances, 0: not known, or
        None; all float32 or all float64.
    weights: of normals that agree with the depth, of distortion, of known distances; the scene's
        extent.
    dalpha, ddepth, ddistortion, dnormals: overwritten by the gradients.

Returns:
    The three terms, each times its weight.

Raises:
    InputError: wrong shapes or dtypes.

The same bits on any number of threads. Source: Huang et al., "2D Gaussian splatting", 2024,
equations 13 and 14.
)doc");

  m.def("photometric_loss_reference", &LossReference, py::arg("target"), py::arg("image"),
        py::arg("mask") = py::none(), py::arg("ssim_weight") = kDefaultSsimWeight,
        py::arg("window_rule") = "partial", R"doc(
The photometric loss and gradient in double, straight from the formulas (slow: the truth of tests).

Args:
    target, image: (H, W, 3) float64.
    mask, ssim_weight, window_rule: as for PhotometricTarget and photometric_loss.

Returns:
    loss, gradient: float and (H, W, 3) float64.
)doc");

  m.def("psnr", &PsnrOfArrays, py::arg("a"), py::arg("b"), py::arg("mask"), py::arg("weights"),
        "PSNR in dB of (H, W, 3) float64 images; see gsut.metrics.");
  m.def("ssim", &SsimOfArrays, py::arg("a"), py::arg("b"), py::arg("mask"), py::arg("window_rule"),
        "SSIM of (H, W, 3) float64 images; see gsut.metrics.");
}

}  // namespace gsut::bindings
