// Places the rays of a camera by the poses of its lines, and takes their gradients back to these.
#include "gsut/raster/view_rays.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>

#include "gsut/base/check_arguments.h"
#include "gsut/base/parallel.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;

constexpr std::int64_t kRowsPerChunk = 8;

std::vector<Pose> LinePoses(const Camera& camera, const CameraMotion& motion) {
  const int lines = motion.shutter.NumLines(camera.width(), camera.height());
  std::vector<Pose> poses;
  poses.reserve(static_cast<std::size_t>(lines));
  for (int line = 0; line < lines; ++line) {
    poses.push_back(motion.At(motion.shutter.LineTime(line, camera.width(), camera.height())));
  }
  return poses;
}

}  // namespace

void CheckViewRays(const ViewRays& view) {
  const auto fits = [&](std::size_t size, std::size_t row) {
    return view.width > 0 && view.height > 0 &&
           size == row * static_cast<std::size_t>(view.width) * view.height;
  };
  if (fits(view.valid.size(), 1) && fits(view.rays.size(), 3) &&
      (view.origins.empty() || fits(view.origins.size(), 3))) {
    return;
  }
  throw InputError("rays, origins and valid must have a row a pixel of a " +
                   std::to_string(view.width) + " x " + std::to_string(view.height) + " image");
}

void CheckRayGradients(const ViewRays& view, const Camera& camera, const RayGradients& gradients,
                       bool with_origins) {
  CheckViewRays(view);
  if (view.width == camera.width() && view.height == camera.height() &&
      gradients.rays.size() == view.rays.size() &&
      (!with_origins || gradients.origins.size() == view.rays.size())) {
    return;
  }
  throw InputError("gradients to rays must be shaped like the rays of the camera's image");
}

bool HasOneCenter(const Camera& camera, const CameraMotion& motion) {
  return motion.shutter.IsGlobal() && camera.IsCentral();
}

ViewRays MakeViewRays(const Camera& camera, const CameraMotion& motion) {
  ViewRays view;
  view.width = camera.width();
  view.height = camera.height();
  view.reference = motion.Middle();
  view.is_parallel = camera.IsParallel();
  const RayTable& table = camera.Rays();
  view.valid = table.valid;
  if (HasOneCenter(camera, motion)) {
    view.rays = table.rays;
    return view;
  }
  // The table's rays are in the frame of the camera as it reads their line. All lines are placed
  // into one frame, the reference's: d' = R d and o' = R o + t, with (R, t) = reference_from_line.
  // reference_from_line: what the camera at a line's time looks like from the reference.
  std::vector<Pose> placed = LinePoses(camera, motion);
  for (Pose& pose : placed) pose = view.reference * pose.Inverse();
  view.rays.resize(table.rays.size());
  view.origins.resize(table.rays.size());
  ParallelFor(view.height, kRowsPerChunk, [&](std::int64_t begin, std::int64_t end) {
    for (int y = static_cast<int>(begin); y < end; ++y) {
      for (int x = 0; x < view.width; ++x) {
        const std::size_t i = 3 * (static_cast<std::size_t>(y) * view.width + x);
        const Pose& pose = placed[static_cast<std::size_t>(motion.shutter.LineOf(x, y))];
        Map<Vector3d>(&view.rays[i]) = pose.rotation * Map<const Vector3d>(&table.rays[i]);
        Vector3d origin = pose.translation;
        if (!table.origins.empty()) {
          origin += pose.rotation * Map<const Vector3d>(&table.origins[i]);
        }
        Map<Vector3d>(&view.origins[i]) = origin;
      }
    }
  });
  return view;
}

// From the gradients to rays, in the reference's frame, to those of the poses at both ends of the
// readout, in three steps:
//   1. to a twist xi = (v, w) of each line's pose, camera_from_world' = exp(xi) camera_from_world,
//   which moves all rays of the line together;
//   2. through the interpolation at the line's time to the twists of the start and the end;
//   3. the colours, shaded from the reference alone, do the same at the time of the middle.
void ChainToPoses(const ViewRays& view, const Camera& camera, const CameraMotion& motion,
                  const RayGradients& gradients, const ShadingGradient& shading, double* dpose) {
  CheckRayGradients(view, camera, gradients, true);
  CheckGiven(dpose, "dpose");
  const RayTable& table = camera.Rays();
  const std::vector<Pose> poses = LinePoses(camera, motion);
  std::vector<Vector6d> sums(poses.size(), Vector6d::Zero());
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      const std::size_t pixel = static_cast<std::size_t>(y) * view.width + x;
      if (!view.valid[pixel]) continue;
      const std::size_t i = 3 * pixel;
      const std::size_t line = static_cast<std::size_t>(motion.shutter.LineOf(x, y));
      // Into the frame of the camera as it read this line.
      const Eigen::Matrix3d line_from_reference =
          poses[line].rotation * view.reference.rotation.transpose();
      const Vector3d g_origin = line_from_reference * Map<const Vector3d>(&gradients.origins[i]);
      const Vector3d g_ray = line_from_reference * Map<const Vector3d>(&gradients.rays[i]);
      // xi = (v, w): the centre moves by -R^T v, rays and the lens' own origins turn by -w.
      sums[line].head<3>() -= g_origin;
      sums[line].tail<3>() -= Map<const Vector3d>(&table.rays[i]).cross(g_ray);
      if (!table.origins.empty()) {
        sums[line].tail<3>() -= Map<const Vector3d>(&table.origins[i]).cross(g_origin);
      }
    }
  }
  Vector6d start = Vector6d::Zero(), end = Vector6d::Zero();
  const auto chain = [&](double t, const Vector6d& g) {
    const MotionJacobian jacobian = motion.JacobianAt(t);
    start += jacobian.from_start.transpose() * g;
    end += jacobian.from_end.transpose() * g;
  };
  for (std::size_t line = 0; line < sums.size(); ++line) {
    chain(motion.shutter.LineTime(static_cast<int>(line), view.width, view.height), sums[line]);
  }
  Vector6d middle = Vector6d::Zero();
  middle.head<3>() = -(view.reference.rotation * shading.center);
  middle.tail<3>() = -Vector3d::UnitZ().cross(view.reference.rotation * shading.axis);
  chain(motion.MiddleTime(), middle);
  std::copy_n(start.data(), 6, dpose);
  if (!motion.shutter.IsGlobal()) std::copy_n(end.data(), 6, dpose + 6);
}

}  // namespace gsut
