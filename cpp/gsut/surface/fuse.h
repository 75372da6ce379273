// Depth maps to a truncated signed distance field, kept only near surfaces.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "gsut/surface/depth_view.h"
#include "gsut/surface/space.h"

namespace gsut {

inline constexpr int kBlockSide = 8;
inline constexpr int kBlockVoxels = kBlockSide * kBlockSide * kBlockSide;

// Blocks of 8 x 8 x 8 voxels, ordered by where they are. A voxel lies on whole grid coordinates;
// its value is the signed distance to the surface in voxels, positive on the cameras' side, NaN
// where no view says anything. x runs fastest.
struct DistanceField {
  VoxelSpace space;
  std::vector<std::array<std::int32_t, 3>> blocks;  // grid coordinates / 8, in increasing order
  std::vector<float> values;                        // (blocks, 512)

  // Number of the block with these coordinates, -1 if there is none.
  std::int64_t Find(const std::array<std::int32_t, 3>& block) const;
};

struct FuseOptions {
  double truncation = 4;  // voxels on both sides of the surface
  // Weight of what says only that a voxel is free (the surface lies more than the truncation
  // behind), against what says where the surface is.
  double free_weight = 0.1;
  std::int64_t max_blocks = 0;  // more throw InputError; 0: any number
};

// The weighted mean over the views of the distance to each view's surface, measured along the
// voxel's ray times the cosine there. Weight: the view's, times the cosine, over the squared
// distance, falling to 0 behind the surface. Blocks are kept where some pixel's depth lies. The
// same bits on any number of threads. Work grows with voxels x views that see them.
DistanceField FuseDepth(const std::vector<DepthView>& views, const VoxelSpace& space,
                        const FuseOptions& options);

}  // namespace gsut
