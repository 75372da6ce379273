// Renders all images of a photometric problem and carries slopes of rays to poses and lenses.
#include "gsut/sfm/photometric_scene.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>

#include "gsut/base/errors.h"
#include "gsut/cameras/ray_jacobian.h"
#include "gsut/sfm/lens_parameters.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;
using RowMatrix3d = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Matrix3X = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::RowMajor>;

// dcolour/dparams = dcolour/dray dray/dparams: a parameter of the lens moves the ray of a pixel.
// Those that are held keep zeros. free: indices of the others.
void CarryToLens(const Camera& camera, const std::vector<int>& free,
                 const std::vector<double>& rays, ImageState* state) {
  const std::size_t count = rays.size() / 3;
  const int num_params = camera.num_params();
  std::vector<double> by_free(3 * count * free.size());
  std::vector<std::uint8_t> valid(count);
  RayJacobian(camera, static_cast<std::int64_t>(count), rays.data(), nullptr, free, by_free.data(),
              nullptr, valid.data());
  state->by_lens.assign(3 * count * static_cast<std::size_t>(num_params), 0.0);
  for (std::size_t i = 0; i < count; ++i) {
    Map<Matrix3X> by_lens(&state->by_lens[3 * i * static_cast<std::size_t>(num_params)], 3,
                          num_params);
    const Map<const Matrix3X> own(&by_free[3 * i * free.size()], 3, static_cast<int>(free.size()));
    by_lens(Eigen::all, free) = Map<const RowMatrix3d>(&state->by_turn[9 * i]) * own;
  }
}

// R <- exp(w) R turns the rays by -w in the camera's axes: dcolour/dw = -(d x dcolour/dd), in
// place.
void CarryToTurn(const std::vector<double>& rays, ImageState* state) {
  for (std::size_t i = 0; 3 * i < rays.size(); ++i) {
    const Map<const Vector3d> ray(&rays[3 * i]);
    Map<RowMatrix3d> slope(&state->by_turn[9 * i]);
    for (int c = 0; c < 3; ++c) {
      slope.row(c) = Vector3d(slope.row(c)).cross(ray).transpose().eval();
    }
  }
}

}  // namespace

SceneEvaluation::SceneEvaluation(SceneColors* scene, const std::vector<Camera>& cameras,
                                 const std::vector<PhotometricImage>& images,
                                 const PhotometricRefinementOptions& options)
    : options_(options), scene_(scene), cameras_(cameras), images_(images) {
  for (const Camera& camera : cameras) lenses.push_back(camera.params());
  for (const PhotometricImage& image : images) {
    ImageState state;
    state.pose = ToBlock(image.camera_from_world);
    state.gain = {image.gain, image.bias};
    states.push_back(std::move(state));
  }
}

bool SceneEvaluation::LensIsFree(int camera) const {
  return !options_.lens_free.empty() &&
         !options_.lens_free[static_cast<std::size_t>(camera)].empty();
}

Camera SceneEvaluation::MakeLens(int camera) const {
  const Camera& before = cameras_[static_cast<std::size_t>(camera)];
  if (!LensIsFree(camera)) return before;
  return {before.model(), lenses[static_cast<std::size_t>(camera)], before.width(), before.height(),
          before.valid_field_angle()};
}

// The same, or none if the parameters make no lens.
std::optional<Camera> SceneEvaluation::FindLens(int camera) const {
  try {
    return MakeLens(camera);
  } catch (const InputError&) {
    return std::nullopt;
  }
}

// Ceres announces as new also the point evaluated last, so the point itself is compared: a render
// costs far more than a comparison.
void SceneEvaluation::PrepareForEvaluation(bool evaluate_jacobians, bool /*is_new_point*/) {
  std::vector<double> point = Point();
  if (point == rendered_ && (has_jacobians_ || !evaluate_jacobians)) return;
  rendered_ = std::move(point);
  has_jacobians_ = evaluate_jacobians;
  ++num_evaluations;
  std::vector<std::optional<Camera>> now;
  now.reserve(cameras_.size());
  for (std::size_t c = 0; c < cameras_.size(); ++c) now.push_back(FindLens(static_cast<int>(c)));
  for (std::size_t i = 0; i < states.size(); ++i) {
    const std::optional<Camera>& camera = now[static_cast<std::size_t>(images_[i].camera)];
    states[i].failed = !camera || !Evaluate(*camera, images_[i], &states[i]);
  }
}

// All parameters that a render depends on; gains do not change it.
std::vector<double> SceneEvaluation::Point() const {
  std::vector<double> point;
  for (const std::vector<double>& lens : lenses)
    point.insert(point.end(), lens.begin(), lens.end());
  for (const ImageState& state : states) {
    point.insert(point.end(), state.pose.begin(), state.pose.end());
  }
  return point;
}

// False if a pixel has no ray.
bool SceneEvaluation::Evaluate(const Camera& camera, const PhotometricImage& image,
                               ImageState* state) {
  const std::size_t count = image.pixels.size();
  const RayTable& table = camera.Rays();
  for (const std::uint32_t pixel : image.pixels) {
    if (!table.valid[pixel]) return false;
  }
  state->colors.resize(3 * count);
  if (!has_jacobians_) {
    scene_->Evaluate(camera, FromBlock(state->pose), image.pixels, state->colors.data(), nullptr,
                     nullptr);
    return true;
  }
  state->by_center.resize(9 * count);
  state->by_turn.resize(9 * count);  // first by the ray, as the scene gives it
  scene_->Evaluate(camera, FromBlock(state->pose), image.pixels, state->colors.data(),
                   state->by_center.data(), state->by_turn.data());
  std::vector<double> rays(3 * count);
  for (std::size_t i = 0; i < count; ++i) {
    std::copy_n(&table.rays[3 * std::size_t{image.pixels[i]}], 3, &rays[3 * i]);
  }
  if (LensIsFree(image.camera)) {
    const auto& flags = options_.lens_free[static_cast<std::size_t>(image.camera)];
    CarryToLens(camera, FreeLensParams(flags), rays, state);
  }
  CarryToTurn(rays, state);
  return true;
}

}  // namespace gsut
