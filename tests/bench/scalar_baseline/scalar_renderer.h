// The scalar float renderer that `./run bench` measures the vectorised one against: what a plain
// C++ implementation of 3DGUT does on a processor.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "gsut/base/stopwatch.h"
#include "gsut/cameras/camera.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/geometry/pose.h"
#include "gsut/projection/project.h"
#include "gsut/raster/blend_rule.h"

namespace gsut {

// Per pixel, one Gaussian of the tile's list after the other: the ray is brought into the
// Gaussian's whitened frame, D = |m x d| / |d| (Wu et al., 3DGUT, 2025, section 4.1), libm's expf;
// lists of 16 x 16 tiles from the rectangles of unscented extents, as public implementations have;
// threads over tiles. Compiled with the project's flags (-O3) for the base
// instruction set of the platform, without intrinsics.
//
// What it shares with the fast renderer: the vectorised projection (so that the comparison is about
// the rasteriser; it makes the baseline faster than a scalar one) and the thread pool. Errors
// against the double reference: those of float arithmetic, and what lies outside of the ellipse of
// unscented extents, which is no bound of a Gaussian's footprint.
class ScalarRenderer {
 public:
  static constexpr int kTile = 16;

  // widen: the unscented extents are multiplied by it. 1 is what public implementations do; with
  // more, less is lost outside of the ellipses and more is evaluated in vain.
  explicit ScalarRenderer(double widen = 1.0) : widen_(static_cast<float>(widen)) {}

  // Writes image (H, W, 3) and alpha (H, W), row-major. The arrays behind `gaussians` must live,
  // unchanged, until the backward call. A Gaussian with a parameter that is not finite is not
  // drawn.
  void Render(const GaussiansView<const float>& gaussians, const Camera& camera,
              const Pose& camera_from_world, const RenderSettings& settings,
              const UnscentedOptions& unscented, float* image, float* alpha);

  // Gradients of L = sum(dimage * image) for the last Render; all of `gradients`, shaped like the
  // Gaussians, is overwritten. Throws InputError without a Render before it, or on another shape.
  void Backward(const float* dimage, const GaussiansView<float>& gradients);

  // Stages of the last calls: "project", "lists", "forward", "backward", "gradients".
  const std::vector<StageTime>& timings() const { return timings_; }
  // (tile, Gaussian) pairs listed; (pixel, Gaussian) pairs evaluated, up to each pixel's last that
  // was blended; and the blended ones.
  std::int64_t num_pairs() const { return static_cast<std::int64_t>(list_.size()); }
  std::int64_t num_evaluated() const;
  std::int64_t num_blended() const;

 private:
  // A Gaussian as the pixel loop wants it, in world axes about the camera centre.
  struct Splat {
    float whiten[9];    // A = S^-1 R^T, row-major
    float whitened[3];  // A m, m the mean
    float opacity;
    float color[3];
    float key;         // of the order
    unsigned clamped;  // bits of the colour's channels, see EvalHarmonics
  };
  // Sums over pixels: dL/dA, dL/d(A m), dL/dcolor, dL/dopacity.
  struct SplatGradient {
    float whiten[9], whitened[3], color[3], opacity;
  };
  // Tiles [x0, x1) x [y0, y1).
  struct Rectangle {
    int x0 = 0, x1 = 0, y0 = 0, y1 = 0;
    int Area() const { return x0 < x1 && y0 < y1 ? (x1 - x0) * (y1 - y0) : 0; }
  };
  // A cone that holds the rays of a tile; cosine > 1 if the tile has none.
  struct TileCone {
    float axis[3];
    float cosine, sine;
  };

  void PrepareRays(const Camera& camera, const Pose& camera_from_world);
  void MakeSplats(const Pose& camera_from_world);
  // mean: about the camera centre, in world axes.
  Rectangle RectangleOf(std::size_t gaussian, const float* mean) const;
  void MakeLists();
  void RenderTile(int tile, float* image, float* alpha);
  void BackwardTile(int tile, const float* dimage);
  void ChainToParameters(std::int64_t gaussian, const GaussiansView<float>& gradients) const;

  // visit(pixel) for the pixels of a tile.
  template <class Visit>
  void ForEachPixel(int tile, Visit&& visit) const {
    const int x0 = tile % tiles_x_ * kTile, y0 = tile / tiles_x_ * kTile;
    const int x1 = x0 + kTile < width_ ? x0 + kTile : width_;
    const int y1 = y0 + kTile < height_ ? y0 + kTile : height_;
    for (int y = y0; y < y1; ++y) {
      for (int x = x0; x < x1; ++x) visit(static_cast<std::size_t>(y) * width_ + x);
    }
  }

  float widen_;
  GaussiansView<const float> gaussians_;
  RenderSettings settings_;
  Eigen::Vector3d center_;
  Splats projected_;
  int width_ = 0, height_ = 0, tiles_x_ = 0, tiles_y_ = 0, sh_degree_ = 0;
  std::vector<float> rays_;                // (H, W, 3) in world axes
  std::vector<std::uint8_t> valid_;        // (H, W)
  std::vector<TileCone> cones_;            // (tiles)
  std::vector<Splat> splats_;              // (N)
  std::vector<Rectangle> rectangles_;      // (N)
  std::vector<std::uint32_t> list_;        // Gaussians by tile, nearest first
  std::vector<std::uint32_t> tile_begin_;  // (tiles + 1)
  std::vector<std::uint32_t> slot_begin_;  // (N + 1): a Gaussian's pairs, tile by tile
  std::vector<float> transmittance_;       // (H, W)
  std::vector<std::uint32_t> evaluated_;   // (H, W): up to the last Gaussian that was blended
  std::vector<std::uint32_t> blended_;     // (H, W)
  std::vector<SplatGradient> slot_gradients_;
  std::vector<StageTime> timings_;
  bool rendered_ = false;
};

}  // namespace gsut
