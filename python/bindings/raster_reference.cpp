// Binds the double reference.
#include <pybind11/pybind11.h>

#include "bindings/geometry.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "bindings/raster.h"

namespace gsut::bindings {
namespace {

// The scalar renderer in double, slow: what tests compare with.
py::tuple RenderDouble(const py::object& gaussians, const BoundJob& job, const py::object& pixels) {
  const auto view = ConstGaussians<double>(gaussians);
  const py::ssize_t h = job.camera.height(), w = job.camera.width();
  const std::uint8_t* chosen = OptionalData<std::uint8_t>(pixels, "pixels", {h, w});
  const auto channels = ChannelsOf<double>(job, view.size);
  ReferenceImage result;
  {
    const LongCall released;
    result = RenderReference(view, job.camera, job.motion, job.settings, chosen, channels);
  }
  return ReferenceArrays(result, h, w);
}

// Keywords: dalpha, ddepth, ddistortion (H, W), dfeatures (H, W, D), to_features (N, D), pixels
// (H, W) uint8, with_lens.
py::tuple BackwardDouble(const py::object& gaussians, const BoundJob& job, const py::object& dimage,
                         const py::object& gradients, const py::kwargs& keywords) {
  py::object dalpha = py::none(), ddepth = py::none(), ddistortion = py::none();
  py::object dfeatures = py::none(), to_features = py::none(), pixels = py::none();
  bool with_lens = false;
  SettingsReader reader(keywords, "render_reference_backward");
  reader.Read("dalpha", &dalpha);
  reader.Read("ddepth", &ddepth);
  reader.Read("ddistortion", &ddistortion);
  reader.Read("dfeatures", &dfeatures);
  reader.Read("to_features", &to_features);
  reader.Read("pixels", &pixels);
  reader.Read("with_lens", &with_lens);
  reader.CheckAllRead();
  const auto view = ConstGaussians<double>(gaussians);
  const auto out = MutableGaussians<double>(gradients);
  const Camera& camera = job.camera;
  const CameraMotion& motion = job.motion;
  const std::int64_t h = camera.height(), w = camera.width();
  ReferenceGradients to_image = {ConstData<double>(dimage, "dimage", {h, w, 3}),
                                 OptionalData<double>(dalpha, "dalpha", {h, w}),
                                 OptionalData<double>(ddepth, "ddepth", {h, w}),
                                 OptionalData<double>(ddistortion, "ddistortion", {h, w})};
  if (!dfeatures.is_none()) {
    to_image.channels = ChannelsOf<double>(job, view.size);
    const std::int64_t count = to_image.channels.count;
    to_image.channel_image = ConstData<double>(dfeatures, "dfeatures", {h, w, count});
    to_image.to_channels = MutableData<double>(to_features, "to_features", {view.size, count});
  }
  const std::uint8_t* chosen = OptionalData<std::uint8_t>(pixels, "pixels", {h, w});
  double dpose[12] = {};
  LensGradient lens;
  {
    const LongCall released;
    RenderReferenceBackward(view, camera, motion, job.settings, to_image, out, dpose, &lens.to_rays,
                            chosen);
    if (with_lens) lens.Chain(camera, motion);
  }
  return py::make_tuple(PoseGradient(dpose, motion), lens.Arrays(camera, with_lens));
}

}  // namespace

void BindRasterReference(py::module_& m) {
  m.def("render_reference", &RenderDouble, py::arg("gaussians"), py::arg("job"),
        py::arg("pixels") = py::none());
  m.def("render_reference_backward", &BackwardDouble, py::arg("gaussians"), py::arg("job"),
        py::arg("dimage"), py::arg("gradients"));
}

}  // namespace gsut::bindings
