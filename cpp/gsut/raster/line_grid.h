// Rays that do not start at one point, cut into 16 x 16 tiles, with a pyramid of bounds over them.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "gsut/base/aligned_vector.h"
#include "gsut/raster/tile_grid.h"
#include "gsut/raster/view_rays.h"

namespace gsut {

// What bounds a bundle of lines. A line in the frame (D, E1, E2) of a bundle is
//   a E1 + b E2 + x (D + s E1 + t E2), x from `slide` on, where the line's own origin lies:
// four numbers in a plane and a direction, because a Gaussian's response does not depend on where
// on its line a ray starts.
struct LineBundle {
  static constexpr int kD = 0;       // 3 floats, then E1 and E2
  static constexpr int kCenter = 9;  // of a, b, s, t: the middle of their ranges ...
  static constexpr int kHalf = 13;   // ... and half their width
  static constexpr int kSlide = 17;  // the least slide
  static constexpr int kState = 18;  // kEmpty, kNarrow or kWide
  static constexpr int kSize = 19;
  static constexpr float kEmpty = 0;   // no ray
  static constexpr float kNarrow = 1;  // bounded by the above
  static constexpr float kWide = 2;    // directions spread too far for a frame: not bounded
  float values[kSize] = {};
};

// Nodes of one level of the pyramid, 4 x 4 of the level below each; level 0 are the tiles. They are
// stored in groups of 4 x 4, one group a node of the level above: 19 arrays of 16 floats.
struct LineLevel {
  static constexpr int kGroup = 16;
  int nodes_x = 0, nodes_y = 0, groups_x = 0, groups_y = 0;
  AlignedVector<float> groups;

  const float* Group(int x, int y) const {
    return &groups[(static_cast<std::size_t>(y) * groups_x + x) * LineBundle::kSize * kGroup];
  }
};

// The lines of one image in the frame of its ViewRays' reference.
struct LineGrid {
  // s, t, start, length, alive and the sizes of a tile grid; its bundles and boxes stay empty.
  TileGrid tiles;
  AlignedVector<float> a, b, slide;  // (tiles * 256), swizzled as the tiles' s and t
  std::vector<LineBundle> bundles;   // (tiles)
  AlignedVector<float> block_box;    // per tile 8 x block_stride: centres and halves of a b s t
  std::vector<LineLevel> levels;     // tiles first; the last is one group
  bool is_parallel = false;
  std::int64_t bytes() const;
};

std::shared_ptr<const LineGrid> MakeLineGrid(const ViewRays& view, int lanes);

// The same for a camera and its motion; the grids of the last views are kept.
std::shared_ptr<const LineGrid> LinesOf(const Camera& camera, const CameraMotion& motion,
                                        int lanes);

}  // namespace gsut
