// The C++ core as a web page calls it: cameras, Gaussians and frames behind C functions. No maths
// here.
//
// Objects have handles from 0 on; numbers are passed through memory from web_allocate. A function
// that fails returns a negative number, and web_error says why.
#include <emscripten/emscripten.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <exception>
#include <memory>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/isa.h"
#include "gsut/cameras/camera.h"
#include "gsut/cameras/lens_traits.h"
#include "gsut/formats/camera_model.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/geometry/shutter.h"
#include "gsut/raster/render.h"
#include "gsut/raster/surroundings.h"

namespace gsut {
namespace {

constexpr int kFailed = -1;

std::string message;      // of the last failure
std::string description;  // the last text that was returned

// Objects by handle; what is released leaves its place to the next.
template <class T>
class Shelf {
 public:
  int Add(T object) {
    const auto free = std::find(objects_.begin(), objects_.end(), std::nullopt);
    if (free != objects_.end()) {
      *free = std::move(object);
      return static_cast<int>(free - objects_.begin());
    }
    objects_.emplace_back(std::move(object));
    return static_cast<int>(objects_.size()) - 1;
  }
  const T& At(int handle) const {
    const auto index = static_cast<std::size_t>(handle);
    if (handle < 0 || index >= objects_.size() || !objects_[index]) {
      throw InputError("there is no object " + std::to_string(handle));
    }
    return *objects_[index];
  }
  void Release(int handle) {
    At(handle);
    objects_[static_cast<std::size_t>(handle)].reset();
  }

 private:
  std::vector<std::optional<T>> objects_;
};

Shelf<Camera> cameras;

// What a page draws, in arrays of its own.
struct Scene {
  std::int64_t size = 0;
  int sh_coefficients = 1;
  std::vector<float> numbers;  // means, quats, log_scales, opacity_logits, sh, one after another

  GaussiansView<const float> View() const {
    const float* at = numbers.data();
    const auto take = [&](std::int64_t each) {
      const float* const begin = at;
      at += size * each;
      return begin;
    };
    GaussiansView<const float> view;
    view.size = size;
    view.sh_coefficients = sh_coefficients;
    view.means = take(3);
    view.quats = take(4);
    view.log_scales = take(3);
    view.opacity_logits = take(1);
    view.sh = take(3 * sh_coefficients);
    return view;
  }
};

std::unique_ptr<Scene> scene;
Renderer renderer;

// Runs work() -> int; a failure becomes a message.
template <class Work>
int Guard(const Work& work) {
  try {
    return work();
  } catch (const std::exception& error) {
    message = error.what();
  }
  return kFailed;
}

template <class Values>
void WriteNumbers(std::ostringstream& out, const Values& values) {
  const char* between = "";
  for (const auto value : values) {
    out << between << value;
    between = ",";
  }
}

Pose ReadPose(const double* matrix) {
  return Pose::FromMatrix(Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(matrix));
}

// JSON of one lens model: parameters' names, abilities and the first example.
void WriteModel(std::ostringstream& out, LensModel lens) {
  const LensTraits traits = TraitsOf(lens);
  const LensExample& example = LensExamples(lens).front();
  out << '"' << LensName(lens) << R"(":{"names":")" << LensParamNames(lens) << R"(","has_table":)"
      << (traits.has_table ? "true" : "false") << R"(,"width":)" << example.width << R"(,"height":)"
      << example.height << R"(,"params":[)";
  WriteNumbers(out, std::vector<double>(example.params, example.params + example.num_params));
  out << "]}";
}

}  // namespace
}  // namespace gsut

using namespace gsut;  // NOLINT(google-build-using-namespace): the C functions follow

extern "C" {

EMSCRIPTEN_KEEPALIVE void* web_allocate(int bytes) {
  return std::malloc(static_cast<std::size_t>(bytes));
}
EMSCRIPTEN_KEEPALIVE void web_free(void* memory) { std::free(memory); }
EMSCRIPTEN_KEEPALIVE const char* web_error() { return message.c_str(); }
EMSCRIPTEN_KEEPALIVE const char* web_isa() {
  description = ActiveIsa();
  return description.c_str();
}

// JSON: model -> its parameters' names, whether the last are a table, and an example.
EMSCRIPTEN_KEEPALIVE const char* web_models() {
  std::ostringstream out;
  out.precision(17);
  const std::vector<std::string> names = LensNames();
  for (std::size_t i = 0; i < names.size(); ++i) {
    out << (i == 0 ? '{' : ',');
    WriteModel(out, LensFromName(names[i]));
  }
  out << '}';
  description = out.str();
  return description.c_str();
}

// valid_field_angle: radians; infinity for the whole domain. Returns the camera's handle.
EMSCRIPTEN_KEEPALIVE int web_make_camera(const char* model, int num_params, const double* params,
                                         int width, int height, double valid_field_angle) {
  return Guard([&] {
    return cameras.Add(Camera(model, std::vector<double>(params, params + num_params), width,
                              height, valid_field_angle));
  });
}

// Reads a .cameramodel file's text; name: for messages. Returns the camera's handle.
EMSCRIPTEN_KEEPALIVE int web_read_camera(const char* text, const char* name) {
  return Guard([&] { return cameras.Add(ParseCameraModel(text, name).camera); });
}

EMSCRIPTEN_KEEPALIVE int web_resize_camera(int camera, int width, int height) {
  return Guard([&] { return cameras.Add(cameras.At(camera).Resized(width, height)); });
}

EMSCRIPTEN_KEEPALIVE int web_release_camera(int camera) {
  return Guard([&] {
    cameras.Release(camera);
    return 0;
  });
}

// JSON of a camera; null on failure.
EMSCRIPTEN_KEEPALIVE const char* web_describe_camera(int handle) {
  const int status = Guard([&] {
    const Camera& camera = cameras.At(handle);
    std::ostringstream out;
    out.precision(17);
    out << R"({"model":")" << camera.model() << R"(","width":)" << camera.width() << R"(,"height":)"
        << camera.height() << R"(,"max_angle":)" << std::min(camera.MaxAngle(), 4.0)
        << R"(,"central":)" << (camera.IsCentral() ? "true" : "false") << R"(,"params":[)";
    WriteNumbers(out, camera.params());
    out << "]}";
    description = out.str();
    return 0;
  });
  return status < 0 ? nullptr : description.c_str();
}

// Where (H, W) it is said which pixels have a ray; null on failure.
EMSCRIPTEN_KEEPALIVE const std::uint8_t* web_valid_pixels(int camera) {
  const std::uint8_t* valid = nullptr;
  Guard([&] {
    valid = cameras.At(camera).Rays().valid.data();
    return 0;
  });
  return valid;
}

// points (count, 3) -> pixels (count, 2), valid (count).
EMSCRIPTEN_KEEPALIVE int web_project(int camera, int count, const double* points, double* pixels,
                                     std::uint8_t* valid) {
  return Guard([&] {
    cameras.At(camera).Project(count, points, pixels, valid);
    return 0;
  });
}

// pixels (count, 2) -> origins, rays (count, 3), valid (count).
EMSCRIPTEN_KEEPALIVE int web_unproject(int camera, int count, const double* pixels, double* origins,
                                       double* rays, std::uint8_t* valid) {
  return Guard([&] {
    cameras.At(camera).UnprojectLines(count, pixels, origins, rays, valid);
    return 0;
  });
}

// Makes room for Gaussians; returns where their numbers go: means (N, 3), quats (N, 4), log_scales
// (N, 3), opacity_logits (N), sh (N, K, 3), float32, one after another.
EMSCRIPTEN_KEEPALIVE float* web_make_scene(int size, int sh_coefficients) {
  const int status = Guard([&] {
    scene = std::make_unique<Scene>();
    scene->size = size;
    scene->sh_coefficients = sh_coefficients;
    scene->numbers.resize(static_cast<std::size_t>(size) *
                          static_cast<std::size_t>(11 + 3 * sh_coefficients));
    return 0;
  });
  return status < 0 ? nullptr : scene->numbers.data();
}

// Draws the scene. start, end: camera_from_world (4, 4) of the edges of the image that are read
// first and last, the same for a shutter "global"; background (3); tiles: see RenderJob; image (H,
// W, 3); alpha and depth (H, W), or both null.
EMSCRIPTEN_KEEPALIVE int web_render(int camera, const double* start, const double* end,
                                    const char* shutter, const double* background,
                                    const std::uint8_t* tiles, float* image, float* alpha,
                                    float* depth) {
  return Guard([&] {
    if (scene == nullptr) throw InputError("there are no Gaussians to draw");
    RenderJob job = {cameras.At(camera),
                     CameraMotion(ReadPose(start), ReadPose(end), Shutter::Named(shutter))};
    std::copy_n(background, 3, job.settings.background);
    job.keep_for_backward = false;
    job.tiles = tiles;
    job.image = image;
    job.alpha = alpha;
    job.depth = depth;
    renderer.Render(scene->View(), job);
    return 0;
  });
}

// Fills the open share of an image (H, W, 3) over black with the colour of its surroundings; alpha
// (H, W), valid (H, W).
EMSCRIPTEN_KEEPALIVE int web_fill_surroundings(int width, int height, float* image,
                                               const float* alpha, const std::uint8_t* valid) {
  return Guard([&] {
    const std::size_t count = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    std::vector<float> behind(3 * count);
    if (!ComputeSurroundings(width, height, image, alpha, valid, behind.data())) return 0;
    for (std::size_t i = 0; i < 3 * count; ++i) image[i] += (1.0f - alpha[i / 3]) * behind[i];
    return 0;
  });
}

}  // extern "C"
