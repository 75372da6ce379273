// The rays of a camera cut into 16 x 16 tiles, each in gnomonic coordinates of its own.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "gsut/base/aligned_vector.h"
#include "gsut/cameras/camera.h"

namespace gsut {

inline constexpr int kTileSize = 16;
inline constexpr int kTilePixels = kTileSize * kTileSize;
inline constexpr int kBlockWidth = 4;
// Tiles are searched in cells of 4 x 4, and in groups of as many that begin at every second tile:
// most footprints lie in one group.
inline constexpr int kCellSize = 4;
inline constexpr int kCellTiles = kCellSize * kCellSize;
inline constexpr int kGroupStep = 2;
// Arrays over cells are padded by this many entries so that vectors may read past the last one.
inline constexpr int kCellPadding = 16;

// What bounds a bundle of rays: its gnomonic frame (D, E1, E2), the box around its (s, t) as centre
// and half size, and whether it has rays at all.
struct RayBundle {
  static constexpr int kFrame = 0;   // 9 floats: D.x D.y D.z E1.x ... E2.z
  static constexpr int kCenter = 9;  // s, t
  static constexpr int kHalf = 11;   // s, t
  static constexpr int kHasRay = 13;
  static constexpr int kSize = 14;
  float values[kSize] = {};
};

// The box around a bundle's rays in the camera frame, for tests of linear forms: centre, then half
// of its width and half of its height, 3 floats each. Without rays the centre is no number.
struct RayBox {
  static constexpr int kCenter = 0;
  static constexpr int kHalfS = 3;
  static constexpr int kHalfT = 6;
  static constexpr int kSize = 9;
  float values[kSize];
  explicit RayBox(const RayBundle& bundle);
};

// A ray of tile k is D + s E1 + t E2 (any length: the response of a Gaussian does not depend on
// it), D the mean direction of the tile's rays and E1, E2 orthonormal to it: exact for any lens.
// Pixels are stored block by block, a block being as many pixels as a vector has lanes, 4 wide, so
// that one load fills a vector. Built for a number of lanes; masked pixels have start = 0.
struct TileGrid {
  int width = 0, height = 0;
  int tiles_x = 0, tiles_y = 0;
  int lanes = 0;         // pixels in a block
  int blocks = 0;        // blocks in a tile
  int block_stride = 0;  // blocks rounded up to whole vectors

  AlignedVector<float> s, t;    // (tiles * 256)
  AlignedVector<float> start;   // (tiles * 256) first transmittance: 1, or 0 where there is no ray
  AlignedVector<float> length;  // (tiles * 256) |D + s E1 + t E2|
  std::vector<RayBundle> bundles;  // (tiles)
  AlignedVector<float> center;     // (tiles, 8) D rounded to float, 0, what rounding took, 0
  // The tiles' boxes, group by group: 9 x 16 floats, the 16 tiles of a group row by row.
  int groups_x = 0, groups_y = 0;
  AlignedVector<float> group_tiles;  // (groups, 9, 16)
  int cells_x = 0, cells_y = 0;
  // Each cell as one box: 9 arrays over cells; cell_wide is 1 where its rays spread too far for a
  // frame of their own, and the cell must always be looked into.
  AlignedVector<float> cell_boxes[RayBox::kSize];
  AlignedVector<float> cell_wide;
  // The box of each block: per tile 4 x block_stride floats (centre s, centre t, half s, half t).
  AlignedVector<float> block_box;
  AlignedVector<std::uint64_t> alive;  // per tile: bit b set if block b has a valid pixel
  // A tile whose rays spread over more than a hemisphere has no gnomonic plane (a panorama of a few
  // pixels); then the kernels cannot be used.
  bool too_wide = false;

  int num_cells() const { return cells_x * cells_y; }
  int num_groups() const { return groups_x * groups_y; }
  int num_tiles() const { return tiles_x * tiles_y; }
  // Offset in a swizzled tile of the pixel (column, row) of the tile.
  int PixelOffset(int column, int row) const {
    const int block_rows = lanes / kBlockWidth;
    const int block = (row / block_rows) * (kTileSize / kBlockWidth) + column / kBlockWidth;
    return block * lanes + (row % block_rows) * kBlockWidth + column % kBlockWidth;
  }
};

// The grid for vectors of `lanes` floats (4, 8 or 16); a camera's grids are kept with it for as
// long as the camera lives, so that the second call costs nothing.
std::shared_ptr<const TileGrid> TilesOf(const Camera& camera, int lanes);

}  // namespace gsut
