// The rays of all pixel centres of a camera, built once and shared.
#include <tbb/task_arena.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "gsut/base/parallel.h"
#include "gsut/cameras/camera.h"
#include "gsut/cameras/camera_state.h"
#include "gsut/cameras/visit_lens.h"

namespace gsut {
namespace {

// A ray that misses its pixel by more than this (px) is no ray.
constexpr double kRayTolerance = 1e-6;
constexpr std::int64_t kRowsPerChunk = 4;

// origin: written by lenses that have origins only.
template <class Lens>
bool CheckedRay(const Camera& camera, double u, double v, double* origin, double* ray) {
  const double* params = camera.params().data();
  const int num_params = camera.num_params();
  double point[3];  // the ray at distance 1
  if constexpr (requires { Lens::kHasOrigins; }) {
    if (!Lens::UnprojectLine(camera.domain(), params, num_params, u, v, origin, ray)) return false;
    for (int k = 0; k < 3; ++k) point[k] = origin[k] + ray[k];
  } else {
    if (!Lens::Unproject(camera.domain(), params, num_params, u, v, ray)) return false;
    for (int k = 0; k < 3; ++k) point[k] = ray[k];
  }
  double back_u = 0.0, back_v = 0.0;
  return Lens::Project(camera.domain(), params, num_params, point[0], point[1], point[2], &back_u,
                       &back_v) &&
         std::hypot(back_u - u, back_v - v) <= kRayTolerance;
}

void BuildRays(const Camera& camera, RayTable* table) {
  const std::int64_t width = camera.width();
  const std::int64_t height = camera.height();
  table->rays.resize(static_cast<std::size_t>(3 * width * height));
  table->valid.resize(static_cast<std::size_t>(width * height));
  VisitLens(camera.lens(), [&](auto model) {
    constexpr bool kHasOrigins = requires { decltype(model)::kHasOrigins; };
    if (kHasOrigins) table->origins.resize(table->rays.size());
    ParallelFor(height, kRowsPerChunk, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin * width; i < end * width; ++i) {
        const std::int64_t row = i / width;
        const double u = static_cast<double>(i - row * width) + 0.5;
        const double v = static_cast<double>(row) + 0.5;
        double* ray = &table->rays[3 * i];
        double* origin = kHasOrigins ? &table->origins[3 * i] : nullptr;
        table->valid[i] = CheckedRay<decltype(model)>(camera, u, v, origin, ray);
        if (table->valid[i]) continue;
        std::fill_n(ray, 3, std::numeric_limits<double>::quiet_NaN());
        if (kHasOrigins) std::fill_n(origin, 3, std::numeric_limits<double>::quiet_NaN());
      }
    });
  });
}

}  // namespace

const RayTable& Camera::Rays() const {
  std::call_once(state_->rays_built, [this] {
    // Isolated: while this thread waits for the loop it must not take up other work that could ask
    // for the same table and wait for itself.
    tbb::this_task_arena::isolate([this] { BuildRays(*this, &state_->rays); });
  });
  return state_->rays;
}

std::shared_ptr<const RayTable> Camera::SharedRays() const { return {state_, &Rays()}; }

}  // namespace gsut
