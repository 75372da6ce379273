// The loops over points and pixels of Camera: one dispatch a batch, parallel over chunks.
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "gsut/base/parallel.h"
#include "gsut/cameras/camera.h"
#include "gsut/cameras/visit_lens.h"

namespace gsut {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
// Points a chunk: some tens of microseconds of work.
constexpr std::int64_t kGrain = 512;
// Directions differentiated in one pass.
constexpr int kDirections = 8;

// A divisor that brings points of extreme length to where squares neither overflow nor vanish.
double SafeScale(const double* point) {
  const double size = std::max({std::abs(point[0]), std::abs(point[1]), std::abs(point[2])});
  constexpr double kTooSmall = 1e-100;
  constexpr double kTooLarge = 1e100;
  const bool extreme = size > 0.0 && (size < kTooSmall || size > kTooLarge);
  return extreme ? size : 1.0;
}

// The same for a lens: the image of a point depends on its length if the rays do not meet.
template <class Lens>
double SafeScaleFor(const double* point) {
  return requires { Lens::kHasOrigins; }
  ? 1.0 : SafeScale(point);
}

// NaN marks a point without an image, so that it cannot be mistaken for a pixel.
template <class Lens>
bool ProjectPoint(const Camera& camera, const double* point, double* pixel) {
  const double s = SafeScaleFor<Lens>(point);
  const bool finite = std::isfinite(point[0]) && std::isfinite(point[1]) && std::isfinite(point[2]);
  const bool valid =
      finite && Lens::Project(camera.domain(), camera.params().data(), camera.num_params(),
                              point[0] / s, point[1] / s, point[2] / s, &pixel[0], &pixel[1]);
  if (!valid) pixel[0] = pixel[1] = kNaN;
  return valid;
}

// Forward mode: a Dual carries kDirections derivatives along, and more parameters take more passes.
// Value, and the derivatives along the directions [first, first + kDirections) of (point, params).
template <class Lens>
bool ProjectDirections(const Camera& camera, const double* point, int first,
                       std::vector<Dual<kDirections>>* params, Dual<kDirections>* u,
                       Dual<kDirections>* v) {
  using T = Dual<kDirections>;
  // A variable is its value and a one in its own direction.
  const auto seed = [first](double value, int direction) {
    const bool here = direction >= first && direction < first + kDirections;
    return here ? T(value, direction - first) : T(value);
  };
  const int num_params = camera.num_params();
  for (int i = 0; i < num_params; ++i) (*params)[i] = seed(camera.params()[i], 3 + i);
  const double s = SafeScaleFor<Lens>(point);
  const T x = seed(point[0] / s, 0), y = seed(point[1] / s, 1), z = seed(point[2] / s, 2);
  return Lens::Project(camera.domain(), params->data(), num_params, x, y, z, u, v);
}

}  // namespace

void Camera::Project(std::int64_t count, const double* points, double* pixels,
                     std::uint8_t* valid) const {
  VisitLens(lens(), [&](auto model) {
    ParallelFor(count, kGrain, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        valid[i] = ProjectPoint<decltype(model)>(*this, points + 3 * i, pixels + 2 * i);
      }
    });
  });
}

void Camera::Unproject(std::int64_t count, const double* pixels, double* rays,
                       std::uint8_t* valid) const {
  VisitLens(lens(), [&](auto model) {
    using Lens = decltype(model);
    ParallelFor(count, kGrain, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        double* ray = rays + 3 * i;
        valid[i] = Lens::Unproject(domain(), params().data(), num_params(), pixels[2 * i],
                                   pixels[2 * i + 1], ray);
        if (!valid[i]) ray[0] = ray[1] = ray[2] = kNaN;
      }
    });
  });
}

void Camera::UnprojectLines(std::int64_t count, const double* pixels, double* origins, double* rays,
                            std::uint8_t* valid) const {
  VisitLens(lens(), [&](auto model) {
    using Lens = decltype(model);
    // Lenses with one centre have all origins at 0.
    if constexpr (requires { Lens::kHasOrigins; }) {
      ParallelFor(count, kGrain, [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
          double* origin = origins + 3 * i;
          double* ray = rays + 3 * i;
          valid[i] = Lens::UnprojectLine(domain(), params().data(), num_params(), pixels[2 * i],
                                         pixels[2 * i + 1], origin, ray);
          if (!valid[i]) std::fill_n(origin, 3, kNaN), std::fill_n(ray, 3, kNaN);
        }
      });
    } else {
      Unproject(count, pixels, rays, valid);
      for (std::int64_t i = 0; i < count; ++i)
        std::fill_n(origins + 3 * i, 3, valid[i] ? 0.0 : kNaN);
    }
  });
}

void Camera::ProjectJacobian(std::int64_t count, const double* points, double* pixels,
                             std::uint8_t* valid, double* dpixel_dpoint,
                             double* dpixel_dparams) const {
  // Pixels come from the plain projection, so that asking for derivatives does not change a bit.
  Project(count, points, pixels, valid);
  const int k = num_params();
  const auto loop = [&](auto model, std::int64_t begin, std::int64_t end) {
    using T = Dual<kDirections>;
    // One vector a chunk, not a point: parameters may be thousands.
    std::vector<T> dual_params(k);
    for (std::int64_t i = begin; i < end; ++i) {
      const double* point = points + 3 * i;
      const double scale = SafeScaleFor<decltype(model)>(point);
      const int directions = dpixel_dparams == nullptr ? 3 : 3 + k;
      for (int first = 0; first < directions; first += kDirections) {
        T u, v;
        ProjectDirections<decltype(model)>(*this, point, first, &dual_params, &u, &v);
        for (int d = first; d < std::min(directions, first + kDirections); ++d) {
          // d/dpoint = d/d(point / s) / s.
          const double factor = valid[i] ? (d < 3 ? 1.0 / scale : 1.0) : kNaN;
          const bool of_point = d < 3;
          double* row = of_point ? dpixel_dpoint : dpixel_dparams;
          if (row == nullptr) continue;
          const int width = of_point ? 3 : k;
          const int column = of_point ? d : d - 3;
          row[(2 * i) * width + column] = factor * u.grad[d - first];
          row[(2 * i + 1) * width + column] = factor * v.grad[d - first];
        }
      }
    }
  };
  VisitLens(lens(), [&](auto model) {
    ParallelFor(count, kGrain,
                [&](std::int64_t begin, std::int64_t end) { loop(model, begin, end); });
  });
}

}  // namespace gsut
