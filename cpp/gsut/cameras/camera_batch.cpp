// The loops over points and pixels of Camera: one dispatch a batch, parallel over chunks.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "gsut/base/check_arguments.h"
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
constexpr int kPointSize = 3;  // coordinates of a point

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

// Forward mode: a Dual carries kDirections derivatives along, and more unknowns take more passes.
// A pass differentiates along [first, first + kDirections) of the point's three coordinates and the
// chosen parameters.
struct Pass {
  int first, end;

  // A variable is its value and, if the pass has its direction, a one there.
  Dual<kDirections> Seed(double value, int direction) const {
    using T = Dual<kDirections>;
    const bool here = direction >= first && direction < end;
    return here ? T(value, direction - first) : T(value);
  }
};

// The parameters as Project takes them in a pass. Only a lens with a table takes plain numbers,
// which spares a pass by the point alone thousands of Duals.
template <class Lens, class Compute>
void WithParams(const std::vector<double>& params, std::span<const int> chosen, const Pass& pass,
                std::vector<Dual<kDirections>>* buffer, const Compute& compute) {
  if constexpr (requires { Lens::kHasTable; }) {
    if (pass.end <= kPointSize) return compute(params.data());
  }
  buffer->clear();
  for (const double param : params) buffer->emplace_back(param);
  for (std::size_t k = 0; k < chosen.size(); ++k) {
    (*buffer)[chosen[k]] = pass.Seed(params[chosen[k]], kPointSize + static_cast<int>(k));
  }
  compute(buffer->data());
}

}  // namespace

void Camera::Project(std::int64_t count, const double* points, double* pixels,
                     std::uint8_t* valid) const {
  CheckArray(points, count, "points");
  CheckArray(pixels, count, "pixels");
  CheckArray(valid, count, "valid");
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
  CheckArray(pixels, count, "pixels");
  CheckArray(rays, count, "rays");
  CheckArray(valid, count, "valid");
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
  CheckArray(pixels, count, "pixels");
  CheckArray(origins, count, "origins");
  CheckArray(rays, count, "rays");
  CheckArray(valid, count, "valid");
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
                             std::uint8_t* valid, double* dpixel_dpoint, double* dpixel_dparams,
                             std::span<const int> chosen) const {
  // Pixels come from the plain projection, so that asking for derivatives does not change a bit.
  Project(count, points, pixels, valid);
  for (const int param : chosen) {
    if (param >= 0 && param < num_params()) continue;
    throw InputError("the lens has no parameter " + std::to_string(param) + "; it has " +
                     std::to_string(num_params()));
  }
  const int k = static_cast<int>(chosen.size());
  const int directions = kPointSize + (dpixel_dparams == nullptr ? 0 : k);
  const auto loop = [&](auto model, std::int64_t begin, std::int64_t end) {
    using Lens = decltype(model);
    using T = Dual<kDirections>;
    // Parameters, which may be thousands, are seeded once a pass over the chunk, not once a point.
    std::vector<T> buffer;
    for (int first = 0; first < directions; first += kDirections) {
      const Pass pass{first, std::min(directions, first + kDirections)};
      WithParams<Lens>(params(), chosen, pass, &buffer, [&](const auto* dual_params) {
        for (std::int64_t i = begin; i < end; ++i) {
          const double* point = points + kPointSize * i;
          const double scale = SafeScaleFor<Lens>(point);
          const T x = pass.Seed(point[0] / scale, 0);
          const T y = pass.Seed(point[1] / scale, 1);
          const T z = pass.Seed(point[2] / scale, 2);
          T u, v;
          Lens::Project(domain(), dual_params, num_params(), x, y, z, &u, &v);
          for (int d = pass.first; d < pass.end; ++d) {
            // d/dpoint = d/d(point / s) / s.
            const bool of_point = d < kPointSize;
            const double factor = valid[i] ? (of_point ? 1.0 / scale : 1.0) : kNaN;
            double* row = of_point ? dpixel_dpoint : dpixel_dparams;
            if (row == nullptr) continue;
            const int width = of_point ? kPointSize : k;
            const int column = of_point ? d : d - kPointSize;
            row[(2 * i) * width + column] = factor * u.grad[d - first];
            row[(2 * i + 1) * width + column] = factor * v.grad[d - first];
          }
        }
      });
    }
  };
  VisitLens(lens(), [&](auto model) {
    ParallelFor(count, kGrain,
                [&](std::int64_t begin, std::int64_t end) { loop(model, begin, end); });
  });
}

void Camera::ProjectJacobian(std::int64_t count, const double* points, double* pixels,
                             std::uint8_t* valid, double* dpixel_dpoint,
                             double* dpixel_dparams) const {
  std::vector<int> all(num_params());
  std::iota(all.begin(), all.end(), 0);
  ProjectJacobian(count, points, pixels, valid, dpixel_dpoint, dpixel_dparams, all);
}

}  // namespace gsut
