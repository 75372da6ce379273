// Projects batches of points, and looks depths up.
#include "gsut/surface/depth_view.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "gsut/base/check_arguments.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;

// The depth of rays that meet nothing.
constexpr float kNothing = 1e25f;
// Below, a surface is taken to be seen at this cosine: rounding would decide.
constexpr float kLeastCosine = 0.1f;
// Of the exposure: when a point has settled on its line, and after how many steps it is left there.
constexpr float kSettled = 1e-5f;
constexpr int kMaxSteps = 20;

}  // namespace

// Poses are tabulated once, for each line of a rolling readout, about the scene's centre: float
// coordinates then keep their digits however far the scene lies from the world's origin.
DepthView::DepthView(const Camera& camera, const CameraMotion& motion, const float* depth,
                     const float* weight, const Vector3d& center)
    : camera_(camera), motion_(motion), center_(center), lens_(camera) {
  CheckGiven(depth, "depth");
  place_ = motion.Middle().CenterInSource() - center;
  const Shutter& shutter = motion.shutter;
  const int lines = shutter.NumLines(width(), height());
  const int steps = shutter.IsGlobal() ? 0 : lines;
  for (int i = 0; i <= steps; ++i) {
    const Pose pose = steps == 0 ? motion.Middle() : motion.At(static_cast<double>(i) / steps);
    const Vector3d moved = pose.rotation * center + pose.translation;
    Place place;
    Map<Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>(place.rotation) = pose.rotation.cast<float>();
    Map<Eigen::Vector3f>(place.translation) = moved.cast<float>();
    places_.push_back(place);
  }
  for (int line = 0; line < lines; ++line) {
    line_poses_.push_back(motion.At(shutter.LineTime(line, width(), height())));
  }
  if (steps > 0) {
    const double zero = shutter.PixelTime(0.0, 0.0, width(), height());
    first_time_ = static_cast<float>(zero);
    time_step_ = static_cast<float>(shutter.PixelTime(1.0, 1.0, width(), height()) - zero);
  }
  FillPixels(depth, weight);
}

// The inverse depth is kept, 0 where there is none, and beside it the cosine at which the surface
// is seen. The mean angle between neighbouring pixels says how far apart their points lie.
void DepthView::FillPixels(const float* depth, const float* weight) {
  const RayTable& rays = camera_.Rays();
  pixels_.resize(static_cast<std::size_t>(width()) * height());
  for (std::size_t i = 0; i < pixels_.size(); ++i) {
    const bool has = rays.valid[i] != 0 && depth[i] > 0.0f;  // not NaN
    const float w = weight == nullptr ? 1.0f : weight[i];
    pixels_[i] = {has && w > 0.0f ? 1.0f / std::min(depth[i], kNothing) : 0.0f, 1.0f, w};
  }
  double angle = 0.0;
  std::int64_t count = 0;
  std::vector<float> cosines(pixels_.size());
  for (int y = 0; y < height(); ++y) {
    for (int x = 0; x < width(); ++x) {
      const std::size_t i = static_cast<std::size_t>(y) * width() + x;
      cosines[i] = CosineAt(rays, x, y);
      if (x == 0 || !rays.valid[i] || !rays.valid[i - 1]) continue;
      const Map<const Vector3d> ray(&rays.rays[3 * i]), left(&rays.rays[3 * (i - 1)]);
      angle += (ray - left).norm();
      ++count;
    }
  }
  for (std::size_t i = 0; i < pixels_.size(); ++i) pixels_[i].cosine = cosines[i];
  pixel_angle_ = count > 0 ? angle / static_cast<double>(count) : 1.0;
}

// From the neighbours on the same surface; the camera's own motion within a line or two is left
// out.
float DepthView::CosineAt(const RayTable& rays, int x, int y) const {
  const auto index = [&](int column, int row) {
    return static_cast<std::size_t>(row) * width() + column;
  };
  const std::size_t at = index(x, y);
  const float here = pixels_[at].inverse;
  if (here == 0.0f) return kLeastCosine;
  const auto point = [&](std::size_t i) -> Vector3d {
    Vector3d along = Map<const Vector3d>(&rays.rays[3 * i]) / double{pixels_[i].inverse};
    if (rays.origins.empty()) return along;
    return along + Map<const Vector3d>(&rays.origins[3 * i]);
  };
  const auto along_axis = [&](int dx, int dy) -> Vector3d {
    std::size_t ends[2] = {at, at};
    for (const int side : {0, 1}) {
      const int column = x + (side == 0 ? -dx : dx), row = y + (side == 0 ? -dy : dy);
      if (column < 0 || row < 0 || column >= width() || row >= height()) continue;
      const float other = pixels_[index(column, row)].inverse;
      if (other < here * kSameSurface && other > here / kSameSurface)
        ends[side] = index(column, row);
    }
    return point(ends[1]) - point(ends[0]);
  };
  // The surface through the neighbours' points; a neighbour across an edge is replaced by the
  // pixel.
  const Vector3d normal = along_axis(1, 0).cross(along_axis(0, 1));
  const double length = normal.norm();
  if (!(length > 0.0)) return kLeastCosine;
  const double cosine = std::abs(normal.dot(Map<const Vector3d>(&rays.rays[3 * at]))) / length;
  return std::clamp(static_cast<float>(cosine), kLeastCosine, 1.0f);
}

// Into the camera's frame. A rolling shutter has a pose per line; between two of them rotation and
// translation are interpolated linearly.
void DepthView::Transform(int count, const PointBatch& points, const float* times,
                          PointBatch* out) const {
  if (places_.size() == 1) {
    const Place& p = places_[0];
    const float* r = p.rotation;
    const float* t = p.translation;
    for (int i = 0; i < count; ++i) {
      const float x = points.x[i], y = points.y[i], z = points.z[i];
      out->x[i] = r[0] * x + r[1] * y + r[2] * z + t[0];
      out->y[i] = r[3] * x + r[4] * y + r[5] * z + t[1];
      out->z[i] = r[6] * x + r[7] * y + r[8] * z + t[2];
    }
    return;
  }
  const float steps = static_cast<float>(places_.size() - 1);
  for (int i = 0; i < count; ++i) {
    const float at = times[i] * steps;
    const std::size_t below = std::min(static_cast<std::size_t>(at), places_.size() - 2);
    const float part = at - static_cast<float>(below);
    const Place &a = places_[below], &b = places_[below + 1];
    float r[9], t[3];
    for (int k = 0; k < 9; ++k) r[k] = a.rotation[k] + part * (b.rotation[k] - a.rotation[k]);
    for (int k = 0; k < 3; ++k) {
      t[k] = a.translation[k] + part * (b.translation[k] - a.translation[k]);
    }
    const float x = points.x[i], y = points.y[i], z = points.z[i];
    out->x[i] = r[0] * x + r[1] * y + r[2] * z + t[0];
    out->y[i] = r[3] * x + r[4] * y + r[5] * z + t[1];
    out->z[i] = r[6] * x + r[7] * y + r[8] * z + t[2];
  }
}

// A point's line decides its time, and its time the pose that places it on a line: a fixed point,
// found by iteration from the middle of the exposure. It takes few steps, as the image moves slowly
// against the readout.
void DepthView::Project(int count, const PointBatch& points, ViewedBatch* out) const {
  PointBatch in_camera;
  alignas(64) float times[kPointBatch];
  std::fill_n(times, count, 0.5f);
  const LensBatch batch = {in_camera.x, in_camera.y, in_camera.z, out->u, out->v};
  const bool over_rows = motion_.shutter.RunsOverRows();
  for (int step = 0; step < kMaxSteps; ++step) {
    Transform(count, points, times, &in_camera);
    ProjectPoints(lens_, count, batch);
    if (places_.size() == 1) break;
    float change = 0.0f;
    const float* line = over_rows ? out->v : out->u;
    for (int i = 0; i < count; ++i) {
      const float next = std::clamp(first_time_ + time_step_ * line[i], 0.0f, 1.0f);
      if (!(next >= 0.0f)) continue;  // no pixel
      change = std::max(change, std::abs(next - times[i]));
      times[i] = next;
    }
    if (change <= kSettled) break;
  }
  // Distances are from the ray's own origin, which a lens without one centre has by pixel.
  const std::vector<double>& origins = camera_.Rays().origins;
  for (int i = 0; i < count && !origins.empty(); ++i) {
    if (std::isfinite(out->u[i]) && std::isfinite(out->v[i])) {
      const int column = static_cast<int>(std::clamp(out->u[i], 0.0f, float(width() - 1)));
      const int row = static_cast<int>(std::clamp(out->v[i], 0.0f, float(height() - 1)));
      const double* o = &origins[3 * (static_cast<std::size_t>(row) * width() + column)];
      in_camera.x[i] -= static_cast<float>(o[0]);
      in_camera.y[i] -= static_cast<float>(o[1]);
      in_camera.z[i] -= static_cast<float>(o[2]);
    }
  }
  for (int i = 0; i < count; ++i) {
    const float x = in_camera.x[i], y = in_camera.y[i], z = in_camera.z[i];
    out->distance[i] = std::sqrt(x * x + y * y + z * z);
  }
}

bool DepthView::At(int x, int y, DepthSample* sample) const {
  const Pixel& pixel = pixels_[static_cast<std::size_t>(y) * width() + x];
  if (pixel.inverse == 0.0f) return false;
  *sample = {1.0f / pixel.inverse, pixel.cosine, pixel.weight};
  return true;
}

// The inverse of the depth is interpolated: it is linear in the image where the surface is a plane.
// Not across an edge: there the nearest pixel counts alone.
bool DepthView::Sample(float u, float v, DepthSample* sample) const {
  // NaN fails too.
  if (!(u >= 0.0f && v >= 0.0f && u < float(width()) && v < float(height()))) return false;
  if (!At(static_cast<int>(u), static_cast<int>(v), sample)) return false;
  const float left = u - 0.5f, up = v - 0.5f;
  if (left < 0.0f || up < 0.0f || left >= float(width() - 1) || up >= float(height() - 1)) {
    return true;
  }
  const int x = static_cast<int>(left), y = static_cast<int>(up);
  const Pixel* row = &pixels_[static_cast<std::size_t>(y) * width() + x];
  const Pixel* next = row + width();
  const float least = std::min({row[0].inverse, row[1].inverse, next[0].inverse, next[1].inverse});
  const float most = std::max({row[0].inverse, row[1].inverse, next[0].inverse, next[1].inverse});
  if (most >= kSameSurface * least) return true;
  const float a = left - float(x), b = up - float(y);
  const auto between = [&](float Pixel::*what) {
    const float above = row[0].*what + a * (row[1].*what - row[0].*what);
    const float below = next[0].*what + a * (next[1].*what - next[0].*what);
    return above + b * (below - above);
  };
  *sample = {1.0f / between(&Pixel::inverse), between(&Pixel::cosine), between(&Pixel::weight)};
  return true;
}

// The other way round, from a pixel: its line is known, and with it the pose.
Vector3d DepthView::PointOf(int x, int y, double depth) const {
  const RayTable& rays = camera_.Rays();
  const std::size_t i = 3 * (static_cast<std::size_t>(y) * width() + x);
  Vector3d in_camera = depth * Map<const Vector3d>(&rays.rays[i]);
  if (!rays.origins.empty()) in_camera += Map<const Vector3d>(&rays.origins[i]);
  const Pose& pose = line_poses_[static_cast<std::size_t>(motion_.shutter.LineOf(x, y))];
  return pose.rotation.transpose() * (in_camera - pose.translation) - center_;
}

}  // namespace gsut
