// The innermost loop of fusion: what one view's depths say of a block's voxels.
#pragma once

namespace gsut {

// A view's pixels, row-major: 1 / depth (0: none), cosine and weight, see DepthSample.
struct DepthPixels {
  static constexpr int kFields = 3;
  const float* values;  // (H, W, 3)
  int width, height;
};

// Neighbouring depths whose ratio is larger lie on two surfaces.
inline constexpr float kSameSurface = 1.1f;
// How far behind a surface its distance counts along the ray, in truncations.
inline constexpr float kSlant = 1.5f;
// A point this many times as far away as the depth there is out of sight.
inline constexpr float kWellBehind = 1.1f;

// Voxels as a view sees them, and the sums that grow: of weight x distance in voxels, of weight.
struct SeenVoxels {
  const float *u, *v, *distance;  // as ViewedBatch
  const float* size;              // of each voxel, world units; 0: none
  float *sum, *weight;
};

// count: a multiple of 16; all arrays on 64-byte boundaries. The depth between pixels is that of
// DepthView::Sample.
void AddDepths(const DepthPixels& pixels, float truncation, float free_weight, int count,
               const SeenVoxels& voxels);

// Whether all points lie well behind what the view sees there, by `slack` besides. Those without a
// pixel (NaN) have no say; one without a depth does not lie behind. Arrays and count as above.
bool AllBehind(const DepthPixels& pixels, int count, const float* u, const float* v,
               const float* distance, float slack);

}  // namespace gsut
