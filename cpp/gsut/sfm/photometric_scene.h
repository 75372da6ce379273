// A scene rendered at the parameters of a photometric solver, once for each of its steps.
#pragma once

#include <ceres/evaluation_callback.h>

#include <array>
#include <cstddef>
#include <optional>
#include <vector>

#include "gsut/geometry/pose_block.h"
#include "gsut/sfm/photometric.h"

namespace gsut {

// One image at the solver's current parameters, with the colours of its n pixels there and their
// slopes: by the camera's centre and by its rotation vector (n, 3, 3), by the lens (n, 3, K).
struct ImageState {
  PoseBlock pose;
  std::array<double, 2> gain;  // gain, bias
  std::vector<double> colors, by_center, by_turn, by_lens;
  bool failed = false;  // a pixel has no ray, or the lens' parameters are no lens
};

// Renders every image once for each step of the solver; the costs read their pixels in `states`.
class SceneEvaluation : public ceres::EvaluationCallback {
 public:
  // All are kept by reference.
  SceneEvaluation(SceneColors* scene, const std::vector<Camera>& cameras,
                  const std::vector<PhotometricImage>& images,
                  const PhotometricRefinementOptions& options);

  bool LensIsFree(int camera) const;
  // The lens at the current parameters. Throws InputError if they make no lens.
  Camera MakeLens(int camera) const;

  void PrepareForEvaluation(bool evaluate_jacobians, bool is_new_point) override;

  std::vector<std::vector<double>> lenses;
  std::vector<ImageState> states;
  int num_evaluations = 0;

 private:
  std::optional<Camera> FindLens(int camera) const;
  std::vector<double> Point() const;
  bool Evaluate(const Camera& camera, const PhotometricImage& image, ImageState* state);

  const PhotometricRefinementOptions& options_;
  SceneColors* scene_;
  const std::vector<Camera>& cameras_;
  const std::vector<PhotometricImage>& images_;
  bool has_jacobians_ = false;
  std::vector<double> rendered_;  // the point that `states` are at
};

}  // namespace gsut
