// The rays of all pixel centres of a camera, built once and shared.
#include <algorithm>
#include <cmath>
#include <limits>

#include "gsut/base/parallel.h"
#include "gsut/base/threads.h"
#include "gsut/cameras/camera.h"
#include "gsut/cameras/camera_state.h"

namespace gsut {
namespace {

// A ray that misses its pixel by more than this (px) is no ray.
constexpr double kRayTolerance = 1e-6;
// Pixels whose rays are found and checked together.
constexpr std::int64_t kBatch = 512;

void BuildRays(const Camera& camera, RayTable* table) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  const std::int64_t width = camera.width(), size = width * camera.height();
  table->rays.resize(static_cast<std::size_t>(3 * size));
  table->valid.resize(static_cast<std::size_t>(size));
  // Origins take memory only where rays have their own.
  if (!camera.IsCentral()) table->origins.resize(table->rays.size());
  ParallelFor(size, kBatch, [&](std::int64_t begin, std::int64_t end) {
    double pixels[2 * kBatch] = {}, origins[3 * kBatch], points[3 * kBatch] = {}, back[2 * kBatch];
    std::uint8_t seen[kBatch];
    const std::int64_t count = end - begin;
    for (std::int64_t i = 0; i < count; ++i) {
      const std::int64_t column = (begin + i) % width, row = (begin + i) / width;
      pixels[2 * i] = static_cast<double>(column) + 0.5;
      pixels[2 * i + 1] = static_cast<double>(row) + 0.5;
    }
    double* rays = &table->rays[static_cast<std::size_t>(3 * begin)];
    std::uint8_t* valid = &table->valid[static_cast<std::size_t>(begin)];
    camera.UnprojectLines(count, pixels, origins, rays, valid);
    // A ray is kept if the point at distance one on it projects back to its pixel.
    for (std::int64_t k = 0; k < 3 * count; ++k) points[k] = origins[k] + rays[k];
    camera.Project(count, points, back, seen);
    for (std::int64_t i = 0; i < count; ++i) {
      valid[i] = seen[i] && std::hypot(back[2 * i] - pixels[2 * i],
                                       back[2 * i + 1] - pixels[2 * i + 1]) <= kRayTolerance;
      if (valid[i]) continue;
      std::fill_n(rays + 3 * i, 3, kNaN);
      std::fill_n(origins + 3 * i, 3, kNaN);
    }
    if (table->origins.empty()) return;
    std::copy_n(origins, 3 * count, &table->origins[static_cast<std::size_t>(3 * begin)]);
  });
}

}  // namespace

const RayTable& Camera::Rays() const {
  std::call_once(state_->rays_built, [this] {
    // Isolated: while this thread waits for the loop it must not take up other work that could ask
    // for the same table and wait for itself.
    RunIsolated([this] { BuildRays(*this, &state_->rays); });
  });
  return state_->rays;
}

std::shared_ptr<const RayTable> Camera::SharedRays() const { return {state_, &Rays()}; }

}  // namespace gsut
