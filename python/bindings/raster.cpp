// Binds gsut/raster: blend rule, tiled renderer.
//
// Python owns all arrays; the renderer keeps buffers only.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <memory>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/geometry.h"
#include "bindings/long_call.h"
#include "bindings/module.h"
#include "bindings/raster.h"
#include "bindings/harmonics_step.h"
#include "gsut/raster/render.h"

namespace gsut::bindings {
namespace {

// The keywords of Renderer.backward.
struct BackwardKeywords {
  py::object dalpha = py::none(), ddepth = py::none(), ddistortion = py::none();  // (H, W)
  py::object errors = py::none(), error_sums = py::none();                        // (H, W), (N,)
  py::object dfeatures = py::none(), to_features = py::none();  // (H, W, D), (N, D)
  bool write_untouched = true, with_poses = true, with_lens = false;
  const BoundHarmonicsStep* harmonics_step = nullptr;

  explicit BackwardKeywords(const py::kwargs& keywords) {
    SettingsReader reader(keywords, "backward");
    reader.Read("dalpha", &dalpha);
    reader.Read("ddepth", &ddepth);
    reader.Read("ddistortion", &ddistortion);
    reader.Read("errors", &errors);
    reader.Read("error_sums", &error_sums);
    reader.Read("dfeatures", &dfeatures);
    reader.Read("to_features", &to_features);
    reader.Read("write_untouched", &write_untouched);
    reader.Read("with_poses", &with_poses);
    reader.Read("with_lens", &with_lens);
    reader.Read("harmonics_step", &harmonics_step);
    reader.CheckAllRead();
  }
};

// Not thread-safe: one a Python thread. The Gaussians are kept alive, as the backward pass reads
// them.
// A renderer and what its last image was made from.
class BoundRenderer {
 public:
  void Render(const py::object& gaussians, const BoundJob& bound, const py::object& image,
              const py::object& alpha, const py::object& depth, const py::object& distortion,
              const py::object& features) {
    const auto view = ConstGaussians<float>(gaussians);
    motion_ = bound.motion;
    camera_ = std::make_unique<Camera>(bound.camera);
    height_ = bound.camera.height();
    width_ = bound.camera.width();
    RenderJob job = {bound.camera, bound.motion, bound.settings, bound.unscented};
    job.keep_for_backward = bound.keep;
    const auto in_tiles = [](std::int64_t pixels) { return (pixels + kTileSize - 1) / kTileSize; };
    job.tiles =
        OptionalData<std::uint8_t>(bound.tiles, "tiles", {in_tiles(height_), in_tiles(width_)});
    const auto output = [&](const py::object& array, const char* name) {
      return array.is_none() ? nullptr : MutableData<float>(array, name, {height_, width_});
    };
    job.image = MutableData<float>(image, "image", {height_, width_, 3});
    job.alpha = output(alpha, "alpha");
    job.depth = output(depth, "depth");
    job.distortion = output(distortion, "distortion");
    job.channels = ChannelsOf<float>(bound, view.size);
    channels_ = job.channels.count;
    if (channels_ > 0) {
      job.channel_image = MutableData<float>(features, "features", {height_, width_, channels_});
    }
    kept_ = {bound.features, bound.features_background};
    gaussians_ = gaussians;
    const LongCall released;
    renderer_.Render(view, job);
  }

  // None without with_poses. keywords: see BackwardKeywords.
  py::object Backward(const py::object& dimage, const py::object& gradients,
                      const py::object& touched, const py::kwargs& keywords) {
    const BackwardKeywords how(keywords);
    const BoundHarmonicsStep* const step = how.harmonics_step;
    const ImageGradients to_image = {
        ConstData<float>(dimage, "dimage", {height_, width_, 3}),
        OptionalData<float>(how.dalpha, "dalpha", {height_, width_}),
        OptionalData<float>(how.ddepth, "ddepth", {height_, width_}),
        OptionalData<float>(how.ddistortion, "ddistortion", {height_, width_}),
        OptionalData<float>(how.errors, "errors", {height_, width_}),
        OptionalData<float>(how.dfeatures, "dfeatures", {height_, width_, channels_})};
    const auto view = MutableGaussians<float>(gradients);
    std::uint8_t* touched_data = MutableData<std::uint8_t>(touched, "touched", {view.size});
    double dpose[12] = {};
    has_lens_ = false;
    const GradientRows to = {
        view,
        touched_data,
        how.write_untouched,
        step == nullptr ? nullptr : &step->step,
        how.error_sums.is_none() ? nullptr
                                 : MutableData<float>(how.error_sums, "error_sums", {view.size}),
        how.to_features.is_none()
            ? nullptr
            : MutableData<float>(how.to_features, "to_features", {view.size, channels_})};
    const auto run = [&] {
      renderer_.Backward(to_image, to, how.with_poses ? dpose : nullptr,
                         how.with_lens ? &lens_.to_rays : nullptr);
      if (how.with_lens) lens_.Chain(*camera_, motion_);
    };
    if (step == nullptr) {
      const LongCall released;
      run();
    } else {  // half a step must not stay
      const py::gil_scoped_release released;
      run();
    }
    has_lens_ = how.with_lens;
    if (!how.with_poses) return py::none();
    return PoseGradient(dpose, motion_);
  }

  // (winner (H, W) int32, point (H, W, 3) float32); significance (N,) grows.
  py::tuple AddSignificance(const py::object& chosen, const py::object& significance) {
    const auto* mask = OptionalData<std::uint8_t>(chosen, "chosen", {height_, width_});
    double* sums = MutableData<double>(significance, "significance", {renderer_.frame().size});
    py::array_t<std::int32_t> winner({height_, width_});
    py::array_t<float> point({height_, width_, std::int64_t{3}});
    {
      std::int32_t* winner_data = winner.mutable_data();
      float* point_data = point.mutable_data();
      const LongCall released;
      renderer_.AddSignificance(mask, sums, winner_data, point_data);
    }
    return py::make_tuple(winner, point);
  }

  // sums (N, D) grows by blend weight x features (H, W, D).
  void AddFeatures(const py::object& features, const py::array& sums) {
    const auto count = sums.ndim() == 2 ? sums.shape(1) : py::ssize_t{0};
    const float* map = ConstData<float>(features, "features", {height_, width_, count});
    float* out = MutableData<float>(sums, "sums", {renderer_.frame().size, count});
    const LongCall released;
    renderer_.AddFeatures(map, static_cast<int>(count), out);
  }

  // fisher (N, 21) grows.
  void AddFisher(const py::object& chosen, const py::object& fisher) {
    const auto* mask = OptionalData<std::uint8_t>(chosen, "chosen", {height_, width_});
    double* sums =
        MutableData<double>(fisher, "fisher", {renderer_.frame().size, Renderer::kFisherSums});
    const LongCall released;
    renderer_.AddFisher(mask, sums);
  }

  // support (N, 2) grows.
  void AddSupport(const py::object& photograph, const py::object& chosen,
                  const py::object& support) {
    const float* pixels = ConstData<float>(photograph, "photograph", {height_, width_, 3});
    const auto* mask = OptionalData<std::uint8_t>(chosen, "chosen", {height_, width_});
    const std::int64_t size = renderer_.frame().size;
    double* sums = MutableData<double>(support, "support", {size, Renderer::kSupportSums});
    const LongCall released;
    renderer_.AddSupport(pixels, mask, sums);
  }

  // (median, strongest (H, W), normals (H, W, 3), spread (H, W)) of the last render, float32.
  py::tuple Surface() const {
    auto median = NewArray<float>({height_, width_}),
         strongest = NewArray<float>({height_, width_});
    auto normals = NewArray<float>({height_, width_, 3}),
         spread = NewArray<float>({height_, width_});
    const SurfaceMaps maps = {median.mutable_data(), strongest.mutable_data(),
                              normals.mutable_data(), spread.mutable_data()};
    {
      const LongCall released;
      renderer_.Surface(maps);
    }
    return py::make_tuple(median, strongest, normals, spread);
  }

  // Adds the gradients through the normals.
  void SurfaceBackward(const py::object& dnormals, const py::object& gradients) const {
    const float* to_normals = ConstData<float>(dnormals, "dnormals", {height_, width_, 3});
    const auto view = MutableGaussians<float>(gradients);
    if (view.size != renderer_.frame().size) {
      throw InputError("gradients must be shaped like the rendered Gaussians");
    }
    const LongCall released;
    renderer_.SurfaceBackward(to_normals, view);
  }

  // (directions, origins (H, W, 3)) of the last render's rays, float32.
  py::tuple Rays() const {
    auto directions = NewArray<float>({height_, width_, 3});
    auto origins = NewArray<float>({height_, width_, 3});
    float *direction = directions.mutable_data(), *origin = origins.mutable_data();
    {
      const py::gil_scoped_release release;
      renderer_.Rays(direction, origin);
    }
    return py::make_tuple(directions, origins);
  }

  // (params (K,), rays (H, W, 3)) of the last backward, or None if that was without the lens.
  py::object OfLens() const {
    if (!has_lens_) return py::none();
    return lens_.Arrays(*camera_, true);
  }

  // Distances of the means of the last render (N,); a copy.
  py::array_t<float> Distances() const {
    const Splats& splats = renderer_.splats();
    py::array_t<float> out(static_cast<py::ssize_t>(splats.size));
    std::copy_n(splats.distance.data(), splats.size, out.mutable_data());
    return out;
  }

  // Stage -> (wall, processor) seconds of the last render and backward.
  py::dict Timings() const {
    py::dict out;
    for (const StageTime& time : renderer_.timings()) {
      out[time.stage] = py::make_tuple(time.wall_seconds, time.cpu_seconds);
    }
    return out;
  }

  py::dict Statistics() const {
    const Splats& splats = renderer_.splats();
    std::int64_t uncertain = 0;
    for (std::int64_t i = 0; i < splats.size; ++i) {
      uncertain += splats.status[static_cast<std::size_t>(i)] == SplatStatus::kUncertain;
    }
    py::dict out;
    out["num_visible"] = renderer_.frame().order.size();
    out["num_uncertain"] = uncertain;
    out["num_pairs"] = renderer_.num_pairs();
    out["num_contributing_pairs"] = renderer_.num_contributing_pairs();
    out["buffer_bytes"] = renderer_.buffer_bytes();
    return out;
  }

 private:
  Renderer renderer_;
  py::object gaussians_;
  std::array<py::object, 2> kept_;  // what the renderer reads beside the Gaussians
  CameraMotion motion_;
  std::unique_ptr<Camera> camera_;
  LensGradient lens_;
  bool has_lens_ = false;
  std::int64_t height_ = 0, width_ = 0, channels_ = 0;
};

// Keywords: rule, background (3,), sh_degree, unscented (3,), tiles, keep, features,
// features_background.
BoundJob ReadJob(const Camera& camera, const py::object& pose, const py::kwargs& keywords) {
  BoundJob job = {camera, ReadMotion(pose), {}, {}, py::none(), true, py::none(), py::none()};
  BlendRule rule;
  std::array<double, 3> background = {}, unscented = {1.0, 2.0, 0.0};
  int sh_degree = 3;
  SettingsReader reader(keywords, "RenderJob");
  reader.Read("rule", &rule);
  reader.Read("background", &background);
  reader.Read("sh_degree", &sh_degree);
  reader.Read("unscented", &unscented);
  reader.Read("tiles", &job.tiles);
  reader.Read("keep", &job.keep);
  reader.Read("features", &job.features);
  reader.Read("features_background", &job.features_background);
  reader.CheckAllRead();
  job.settings = Settings(rule, background, sh_degree);
  job.unscented = {unscented[0], unscented[1], unscented[2]};
  return job;
}

}  // namespace

void BindRaster(py::module_& m) {
  py::class_<BlendRule>(m, "BlendRule", R"doc(
How the Gaussians along a ray become a pixel; its fields can be set.

In the rule's order, alpha = min(alpha_max, opacity x response) and weight = alpha x T, where T, the
transmittance, starts at 1 and is multiplied by 1 - alpha. Of models with another response (see
`gsut.Gaussians`) alpha is that response's.

Args:
    parity: "": gsut's own rule. "gsplat", "3dgrut": the rules of these, which order by camera z.

Raises:
    InputError: an unknown parity; the known ones are listed. Rendering raises it for a field that
        is out of range.
)doc")
      .def(py::init([](const std::string& parity) { return BlendRule::Named(parity); }),
           py::arg("parity") = "")
      .def_readwrite("alpha_min", &BlendRule::alpha_min,
                     "Below it a Gaussian is not drawn; in [1e-37, 1).")
      .def_readwrite("alpha_max", &BlendRule::alpha_max,
                     "The most that a Gaussian covers; in (0, 1).")
      .def_readwrite("response_min", &BlendRule::response_min,
                     "Below it a Gaussian is not drawn; in [0, 1).")
      .def_readwrite("transmittance_min", &BlendRule::transmittance_min,
                     "Where blending stops; in [0, 1).")
      .def_readwrite("stop_before", &BlendRule::stop_before,
                     "Whether the Gaussian that would reach transmittance_min is left out.")
      .def_readwrite("near_z", &BlendRule::near_z, "Centres with a smaller camera z are not drawn.")
      .def_readwrite("far_z", &BlendRule::far_z, "Centres with a larger camera z are not drawn.")
      .def_property(
          "order", [](const BlendRule& rule) { return NameOf(rule.order); },
          [](BlendRule& rule, const std::string& name) { rule.order = OrderNamed(name); },
          "What orders Gaussians: the means' \"distance\" or camera \"z\"; \"ray\": where each "
          "pixel's ray is nearest to each of them; \"integral\": no order, they overlap as "
          "densities; \"model\", of gsut's own rule: as the Gaussians say, see `gsut.Gaussians`.");
  py::class_<BoundJob>(m, "RenderJob", "One image to be rendered: its camera, pose and rules.")
      .def(py::init(&ReadJob), py::arg("camera"), py::arg("camera_from_world"));
  py::class_<BoundRenderer>(m, "Renderer", "The tiled float renderer with its buffers.")
      .def(py::init<>())
      .def("render", &BoundRenderer::Render, py::arg("gaussians"), py::arg("job"), py::arg("image"),
           py::arg("alpha") = py::none(), py::arg("depth") = py::none(),
           py::arg("distortion") = py::none(), py::arg("features") = py::none())
      .def("backward", &BoundRenderer::Backward, py::arg("dimage"), py::arg("gradients"),
           py::arg("touched"))
      .def("add_significance", &BoundRenderer::AddSignificance, py::arg("chosen"),
           py::arg("significance"))
      .def("add_fisher", &BoundRenderer::AddFisher, py::arg("chosen"), py::arg("fisher"))
      .def("add_features", &BoundRenderer::AddFeatures, py::arg("features"), py::arg("sums"))
      .def("add_support", &BoundRenderer::AddSupport, py::arg("photograph"), py::arg("chosen"),
           py::arg("support"))
      .def("surface", &BoundRenderer::Surface)
      .def("surface_backward", &BoundRenderer::SurfaceBackward, py::arg("dnormals"),
           py::arg("gradients"))
      .def("rays", &BoundRenderer::Rays)
      .def("lens_gradients", &BoundRenderer::OfLens)
      .def("distances", &BoundRenderer::Distances)
      .def("timings", &BoundRenderer::Timings)
      .def("statistics", &BoundRenderer::Statistics);
}

}  // namespace gsut::bindings
