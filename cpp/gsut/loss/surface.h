// What training for surfaces asks of a rendered depth: normals that agree with it, weights that
// gather at one distance, distances that are known; with gradients.
#pragma once

#include <cstdint>
#include <vector>

namespace gsut {

// A render's maps, row-major, rays in one frame. T: float or double.
template <class T>
struct SurfaceRender {
  std::int64_t height, width;
  const T* directions;  // (H, W, 3) unit rays; 0: none
  const T* origins;     // (H, W, 3)
  const T* alpha;       // (H, W)
  const T* depth;       // (H, W) sum of weight x distance
  const T* distortion;  // (H, W) sum of weight x (distance - mean)^2
  const T* normals;     // (H, W, 3) 0.5 + 0.5 (sum of weight x unit normal)
  const T* known;       // (H, W) distances that are known, 0: not; null: none
};

struct SurfaceWeights {
  double normal = 0, distortion = 0, known = 0;
  double extent = 0;  // of the scene: nearer, the distortion is relative to this
};

// dL to the maps of SurfaceRender, overwritten.
template <class T>
struct SurfaceGradients {
  T* alpha;
  T* depth;
  T* distortion;
  T* normals;
};

// The terms, each times its weight.
struct SurfaceTerms {
  double normal = 0, distortion = 0, known = 0;
};

// normal: sum of weight x (1 - its normal . N), N the normal of the surface which the expected
//   distances of the four neighbours form (2DGS, eq. 14); only where all are covered and no edge
//   lies between them.
// distortion: over the sum of the squares of the mean distance, which counts as a constant, and of
//   the scene's extent (2DGS, eq. 13, up to a factor 2 and the coverage). Without the extent,
//   Gaussians right before the camera would count without bound.
// known: |known / distance - 1|, the error of the inverse distance, relative.
// Each is a mean over all pixels, the last over those that are known. What counts is not
// differentiated. The same bits on any number of threads.
template <class T>
SurfaceTerms SurfaceLoss(const SurfaceRender<T>& render, const SurfaceWeights& weights,
                         const SurfaceGradients<T>& gradients);

}  // namespace gsut
