// Batches of points through the lenses of a bundle, with derivatives.
#include "gsut/sfm/lens_evaluation.h"

#include <algorithm>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/sfm/lens_parameters.h"

namespace gsut {
namespace {

constexpr std::int64_t kEvaluationGrain = 256;  // observations a chunk of parallel work

}  // namespace

LensEvaluation::LensEvaluation(const Bundle& bundle, const BundleState& state,
                               const std::vector<std::vector<std::uint8_t>>& lens_free)
    : bundle_(bundle),
      state_(state),
      batches_(bundle.cameras.size()),
      place_(bundle.observations.size()) {
  // Observations are sorted by camera once: Camera works on batches, with one dispatch each.
  for (std::size_t i = 0; i < bundle.observations.size(); ++i) {
    Batch& batch = batches_[bundle.camera_of_image[bundle.observations[i].image]];
    place_[i] = static_cast<int>(batch.observations.size());
    batch.observations.push_back(static_cast<int>(i));
  }
  for (std::size_t c = 0; c < batches_.size(); ++c) {
    Batch& batch = batches_[c];
    const std::size_t count = batch.observations.size();
    batch.points.resize(3 * count);
    batch.pixels.resize(2 * count);
    batch.valid.resize(count);
    batch.by_point.resize(6 * count);
    if (!lens_free.empty()) batch.free = FreeLensParams(lens_free[c]);
    batch.by_params.resize(2 * count * batch.free.size());
  }
}

void LensEvaluation::Evaluate() {
  for (std::size_t c = 0; c < batches_.size(); ++c) EvaluateBatch(static_cast<int>(c));
}

void LensEvaluation::EvaluateBatch(int camera_index) {
  Batch& batch = batches_[camera_index];
  const auto count = static_cast<std::int64_t>(batch.observations.size());
  if (count == 0) return;
  // Points into the camera's frame at the time of their line; then through the lens as one batch.
  ParallelFor(count, kEvaluationGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const BundleObservation& observation = bundle_.observations[batch.observations[i]];
      Eigen::Map<Eigen::Vector3d>(&batch.points[3 * i]) =
          state_.Chain(observation).Point(state_.points[observation.point]);
    }
  });
  // A camera of the current parameters, whose valid domain is found again: a step of the solver may
  // have shrunk it, or made the parameters no lens at all.
  const Camera& start = bundle_.cameras[camera_index];
  try {
    const bool held = batch.free.empty();
    const Camera camera = held ? start
                               : Camera(start.model(), state_.lenses[camera_index], start.width(),
                                        start.height(), start.valid_field_angle());
    batch.failed = false;
    // Of a lens with thousands of parameters only those that are free.
    camera.ProjectJacobian(count, batch.points.data(), batch.pixels.data(), batch.valid.data(),
                           batch.by_point.data(), held ? nullptr : batch.by_params.data(),
                           batch.free);
  } catch (const InputError&) {  // no lens: the step went too far
    batch.failed = true;
    std::fill(batch.valid.begin(), batch.valid.end(), 0);
  }
  // Panoramas repeat: of the images of a point the one next to the feature counts.
  ParallelFor(count, kEvaluationGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      start.domain().MoveNear(bundle_.observations[batch.observations[i]].pixel.data(),
                              &batch.pixels[2 * i]);
    }
  });
}

// Rows of a batch lie in the order of its observations.
LensEvaluation::Row LensEvaluation::Get(int observation) const {
  const int camera = bundle_.camera_of_image[bundle_.observations[observation].image];
  const Batch& batch = batches_[camera];
  const int i = place_[observation];
  const double* by_params =
      batch.free.empty() ? nullptr : &batch.by_params[2 * i * batch.free.size()];
  return {&batch.pixels[2 * i], &batch.by_point[6 * i], by_params, batch.valid[i] != 0,
          batch.failed};
}

}  // namespace gsut
