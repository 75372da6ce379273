// One photograph's depth, and the way from points of the world to its pixels.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "gsut/cameras/camera.h"
#include "gsut/cameras/lens_kernels.h"
#include "gsut/geometry/shutter.h"
#include "gsut/surface/fuse_kernel.h"

namespace gsut {

// Points projected together: a block of 8 x 8 x 8 voxels.
inline constexpr int kPointBatch = 512;

// Points about some centre that all calls share, and what a view makes of them.
struct PointBatch {
  alignas(64) float x[kPointBatch], y[kPointBatch], z[kPointBatch];
};
struct ViewedBatch {
  // Pixels, NaN where the view's lens has none; distance along the pixel's ray, from its origin.
  alignas(64) float u[kPointBatch], v[kPointBatch], distance[kPointBatch];
};

// What a view says at a pixel.
struct DepthSample {
  static constexpr float kFree = 1e20f;
  float depth;   // along the ray; above kFree: nothing is there
  float cosine;  // of the angle between the ray and the surface's normal, 0.1 at least
  float weight;
};

// A distance along the ray for each pixel. Any lens that has a projection; a rolling shutter by
// seeking the line that sees each point, one without a centre by the origins of its rays.
class DepthView {
 public:
  // depth, weight (H, W): of depth, infinity is a ray that meets nothing, NaN and numbers <= 0 say
  // nothing; weight null: 1. center: about
  // which points will be given.
  DepthView(const Camera& camera, const CameraMotion& motion, const float* depth,
            const float* weight, const Eigen::Vector3d& center);

  int width() const { return camera_.width(); }
  int height() const { return camera_.height(); }
  const Camera& camera() const { return camera_; }
  // Of the camera in the middle of the exposure, about the centre.
  const Eigen::Vector3d& place() const { return place_; }
  DepthPixels pixels() const { return {&pixels_[0].inverse, width(), height()}; }
  // Radians between neighbouring pixels, in the middle.
  double pixel_angle() const { return pixel_angle_; }

  // count: a multiple of 16, kPointBatch at most.
  void Project(int count, const PointBatch& points, ViewedBatch* out) const;

  // False where the pixel has no depth. Between pixels of one surface the inverse of the depth is
  // interpolated, which is exact for a plane through a pinhole; at an edge the nearest pixel is
  // taken.
  bool Sample(float u, float v, DepthSample* sample) const;
  // Of the pixel's centre; false where it has none.
  bool At(int x, int y, DepthSample* sample) const;

  // The point at the depth of a pixel, about the centre.
  Eigen::Vector3d PointOf(int x, int y, double depth) const;

 private:
  struct Pixel {
    float inverse;  // of the depth, 0: none
    float cosine, weight;
  };
  static_assert(sizeof(Pixel) == DepthPixels::kFields * sizeof(float));
  // A place of the camera about the centre: x_in_camera = rotation x + translation.
  struct Place {
    float rotation[9], translation[3];
  };

  void FillPixels(const float* depth, const float* weight);
  float CosineAt(const RayTable& rays, int x, int y) const;
  void Transform(int count, const PointBatch& points, const float* times, PointBatch* out) const;

  Camera camera_;
  CameraMotion motion_;
  Eigen::Vector3d center_, place_;
  FloatLens lens_;
  std::vector<Place> places_;     // evenly spaced over the exposure; one: the camera stands still
  std::vector<Pose> line_poses_;  // camera_from_world as each line is read
  float first_time_ = 0, time_step_ = 0;  // of a line's centre, in lines from the edge
  double pixel_angle_ = 0;
  std::vector<Pixel> pixels_;
};

}  // namespace gsut
