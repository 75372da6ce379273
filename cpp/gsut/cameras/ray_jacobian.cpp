// Derivatives of rays by lens parameters: what keeps a point of the ray on its pixel.
#include "gsut/cameras/ray_jacobian.h"

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <vector>

#include "gsut/base/check_arguments.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;
using Matrix2X = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;
using Matrix3X = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::RowMajor>;

// Distances along a ray at which it is held on its pixel: two points fix a line. A central lens
// needs only the first.
constexpr double kNear = 1.0;
constexpr double kFar = 2.0;

// A point p of the ray stays on its pixel: pixel(p, params) is constant, so J dp + P dparams = 0.
// The least dp is -J^T (J J^T)^-1 P dparams: across the ray, since J takes the ray to 0. shifts
// (count, 3, F): the least motion, a parameter, that leaves the points on their pixels.
void Shifts(const Camera& camera, std::int64_t count, const double* points,
            std::span<const int> chosen, double* shifts, std::uint8_t* valid) {
  const int num_params = static_cast<int>(chosen.size());
  const std::size_t n = static_cast<std::size_t>(count);
  std::vector<double> pixels(2 * n), by_point(6 * n);
  std::vector<double> by_params(2 * n * static_cast<std::size_t>(num_params));
  std::vector<std::uint8_t> inside(n);
  camera.ProjectJacobian(count, points, pixels.data(), inside.data(), by_point.data(),
                         by_params.data(), chosen);
  for (std::size_t i = 0; i < n; ++i) {
    Map<Matrix3X> shift(shifts + 3 * i * static_cast<std::size_t>(num_params), 3, num_params);
    const Map<const Eigen::Matrix<double, 2, 3, Eigen::RowMajor>> jacobian(&by_point[6 * i]);
    const Map<const Matrix2X> params(&by_params[2 * i * static_cast<std::size_t>(num_params)], 2,
                                     num_params);
    const Eigen::Matrix2d square = jacobian * jacobian.transpose();
    if (!inside[i] || !(square.determinant() > 0) || !params.allFinite()) {
      shift.setZero();
      valid[i] = 0;
      continue;
    }
    shift = -jacobian.transpose() * (square.inverse() * params);
  }
}

}  // namespace

void RayJacobian(const Camera& camera, std::int64_t count, const double* rays,
                 const double* origins, std::span<const int> chosen, double* drays,
                 double* dorigins, std::uint8_t* valid) {
  CheckArray(rays, count, "rays");
  CheckArray(drays, count, "drays");
  CheckArray(valid, count, "valid");
  const std::size_t n = static_cast<std::size_t>(count);
  const std::size_t length = 3 * n * chosen.size();
  std::fill_n(valid, n, std::uint8_t{1});
  if (origins == nullptr) {
    Shifts(camera, count, rays, chosen, drays, valid);
    if (dorigins != nullptr) std::fill_n(dorigins, length, 0.0);
    return;
  }
  // Along a line, the shift of its points is that of the origin plus distance times the ray's.
  std::vector<double> points(3 * n), far(length);
  const auto at = [&](double distance) {
    for (std::size_t i = 0; i < 3 * n; ++i) points[i] = origins[i] + distance * rays[i];
    return points.data();
  };
  Shifts(camera, count, at(kNear), chosen, drays, valid);
  Shifts(camera, count, at(kFar), chosen, far.data(), valid);
  for (std::size_t i = 0; i < length; ++i) {
    const double near_shift = drays[i];
    drays[i] = (far[i] - near_shift) / (kFar - kNear);
    if (dorigins != nullptr) dorigins[i] = near_shift - kNear * drays[i];
  }
  // What is invalid at either distance has no derivative at all.
  const std::size_t row = 3 * chosen.size();
  for (std::size_t i = 0; i < n; ++i) {
    if (valid[i]) continue;
    std::fill_n(drays + i * row, row, 0.0);
    if (dorigins != nullptr) std::fill_n(dorigins + i * row, row, 0.0);
  }
}

}  // namespace gsut
