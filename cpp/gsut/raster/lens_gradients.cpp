// The chain rule from rays to lens parameters, row by row of the image.
#include "gsut/raster/lens_gradients.h"

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <numeric>

#include "gsut/base/parallel.h"
#include "gsut/cameras/ray_jacobian.h"

namespace gsut {

// dL/dp = sum over pixels of dL/dd . dd/dp + dL/do . do/dp for the lens parameters p, d and o a
// pixel's ray and origin as the camera has them. A pixel keeps its place: the ray moves, by the
// inverse of the projection's derivative (RayJacobian). Rows are summed apart, then in order.
std::vector<double> ChainToLens(const ViewRays& view, const Camera& camera,
                                const CameraMotion& motion, const RayGradients& gradients) {
  using Eigen::Map;
  using Eigen::Vector3d;
  const RayTable& table = camera.Rays();
  const std::size_t num_params = static_cast<std::size_t>(camera.num_params());
  std::vector<int> all(num_params);
  std::iota(all.begin(), all.end(), 0);
  const std::size_t width = static_cast<std::size_t>(view.width);
  const bool has_origins = !table.origins.empty();
  CheckRayGradients(view, camera, gradients, has_origins);
  std::vector<std::vector<double>> rows(static_cast<std::size_t>(view.height));
  ParallelFor(view.height, 1, [&](std::int64_t y, std::int64_t) {
    std::vector<double>& sum = rows[static_cast<std::size_t>(y)];
    sum.assign(num_params, 0.0);
    // The row's pixels that have a ray and a gradient, in the frame of the camera as it read them.
    std::vector<double> rays, origins, to_rays, to_origins;
    for (std::size_t x = 0; x < width; ++x) {
      const std::size_t pixel = static_cast<std::size_t>(y) * width + x;
      if (!view.valid[pixel]) continue;
      Vector3d to_ray(Map<const Vector3d>(&gradients.rays[3 * pixel]));
      Vector3d to_origin = Vector3d::Zero();
      if (has_origins) to_origin = Map<const Vector3d>(&gradients.origins[3 * pixel]);
      if (to_ray.isZero(0.0) && to_origin.isZero(0.0)) continue;
      if (view.HasOrigins()) {
        const int line = motion.shutter.LineOf(static_cast<int>(x), static_cast<int>(y));
        const Pose pose = motion.At(motion.shutter.LineTime(line, view.width, view.height));
        const Eigen::Matrix3d turn = pose.rotation * view.reference.rotation.transpose();
        to_ray = turn * to_ray;
        to_origin = turn * to_origin;
      }
      rays.insert(rays.end(), &table.rays[3 * pixel], &table.rays[3 * pixel] + 3);
      to_rays.insert(to_rays.end(), to_ray.data(), to_ray.data() + 3);
      if (!has_origins) continue;
      origins.insert(origins.end(), &table.origins[3 * pixel], &table.origins[3 * pixel] + 3);
      to_origins.insert(to_origins.end(), to_origin.data(), to_origin.data() + 3);
    }
    const std::size_t count = rays.size() / 3;
    if (count == 0) return;
    std::vector<double> drays(3 * count * num_params);
    std::vector<double> dorigins(has_origins ? drays.size() : 0);
    std::vector<std::uint8_t> valid(count);
    RayJacobian(camera, static_cast<std::int64_t>(count), rays.data(),
                has_origins ? origins.data() : nullptr, all, drays.data(),
                has_origins ? dorigins.data() : nullptr, valid.data());
    for (std::size_t i = 0; i < 3 * count; ++i) {
      for (std::size_t k = 0; k < num_params; ++k) {
        sum[k] += to_rays[i] * drays[i * num_params + k];
        if (has_origins) sum[k] += to_origins[i] * dorigins[i * num_params + k];
      }
    }
  });
  std::vector<double> total(num_params, 0.0);
  for (const std::vector<double>& row : rows) {
    for (std::size_t k = 0; k < num_params; ++k) total[k] += row[k];
  }
  return total;
}

}  // namespace gsut
