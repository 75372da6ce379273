// Which tiles a Gaussian may touch: a rectangle around its ellipse, or the exact test of all tiles.

#if defined(GSUT_RASTER_TILE_RECT_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_TILE_RECT_INL_H_
#undef GSUT_RASTER_TILE_RECT_INL_H_
#else
#define GSUT_RASTER_TILE_RECT_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/tile_grid.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// The rectangle around all tiles that may hold a pixel with N < z^2, z > 0. Conservative: interval
// bounds of the record's linear forms over the box of each tile's rays, in the tile's own frame.
HWY_INLINE TileRect ExactTileRect(const TileGrid& grid, const float* r) {
  const FloatTag d;
  const auto zero = hn::Zero(d);
  int x0 = grid.tiles_x, x1 = 0, y0 = grid.tiles_y, y1 = 0;
  for (int row = 0; row < grid.tiles_y; ++row) {
    for (int column = 0; column < grid.tiles_x; column += kLanes) {
      const std::size_t tile = static_cast<std::size_t>(row) * grid.tiles_x + column;
      const auto load = [&](const AlignedVector<float>& array) HWY_ATTR {
        return hn::LoadU(d, &array[tile]);
      };
      // Form at the box's centre and how far it can stray inside the box.
      const auto cs = load(grid.box[0]), ct = load(grid.box[1]);
      const auto hs = load(grid.box[2]), ht = load(grid.box[3]);
      FloatVec value[3], spread[3];
      for (int form = 0; form < 3; ++form) {
        const auto fx = hn::Set(d, r[3 * form]), fy = hn::Set(d, r[3 * form + 1]),
                   fz = hn::Set(d, r[3 * form + 2]);
        const auto dot = [&](int axis) HWY_ATTR {
          return hn::MulAdd(fx, load(grid.frame[3 * axis]),
                            hn::MulAdd(fy, load(grid.frame[3 * axis + 1]),
                                       hn::Mul(fz, load(grid.frame[3 * axis + 2]))));
        };
        const auto along_s = dot(1), along_t = dot(2);
        value[form] = hn::MulAdd(along_s, cs, hn::MulAdd(along_t, ct, dot(0)));
        spread[form] = hn::MulAdd(hn::Abs(along_s), hs, hn::Mul(hn::Abs(along_t), ht));
      }
      const auto p = hn::Max(hn::Sub(hn::Abs(value[0]), spread[0]), zero);
      const auto q = hn::Max(hn::Sub(hn::Abs(value[1]), spread[1]), zero);
      const auto z = hn::Max(hn::Add(value[2], spread[2]), zero);
      const auto hit = hn::And(hn::Lt(hn::MulAdd(p, p, hn::Mul(q, q)), hn::Mul(z, z)),
                               hn::Gt(load(grid.has_ray), zero));
      std::uint64_t bits = MaskBits(hit);
      const int rest = grid.tiles_x - column;
      if (rest < kLanes) bits &= (std::uint64_t{1} << rest) - 1;
      if (bits == 0) continue;
      x0 = HWY_MIN(x0, column + static_cast<int>(__builtin_ctzll(bits)));
      x1 = HWY_MAX(x1, column + 64 - static_cast<int>(__builtin_clzll(bits)));
      y0 = HWY_MIN(y0, row);
      y1 = row + 1;
    }
  }
  if (x0 >= x1) return {};
  return {static_cast<std::uint16_t>(x0), static_cast<std::uint16_t>(x1),
          static_cast<std::uint16_t>(y0), static_cast<std::uint16_t>(y1)};
}

// The rectangle of tiles that the box centre +- extent (pixels) meets.
HWY_INLINE TileRect EllipseTileRect(const TileGrid& grid, float u, float v, float extent_u,
                                    float extent_v) {
  // The outermost pixel centres lie half a pixel inside the image's edge.
  const auto tile_of = [](float pixel, int size) {
    const float limit = static_cast<float>(size) - 0.5f;
    const float clamped = pixel < 0.5f ? 0.5f : pixel > limit ? limit : pixel;
    return static_cast<int>(clamped) / kTileSize;
  };
  const int x0 = tile_of(u - extent_u, grid.width), x1 = tile_of(u + extent_u, grid.width);
  const int y0 = tile_of(v - extent_v, grid.height), y1 = tile_of(v + extent_v, grid.height);
  return {static_cast<std::uint16_t>(x0), static_cast<std::uint16_t>(x1 + 1),
          static_cast<std::uint16_t>(y0), static_cast<std::uint16_t>(y1 + 1)};
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
