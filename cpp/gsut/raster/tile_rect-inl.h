// Which tiles a Gaussian may touch: an exact, conservative test of tiles around a guess, or of all.

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

// Half-open rectangle of tiles while it is being found.
struct TileWindow {
  int x0, x1, y0, y1;
  bool empty() const { return x0 >= x1 || y0 >= y1; }
};

// What was found row by row: the tiles' bits from column `base` on, for rows of up to 64 tiles, and
// the span, for any.
struct TouchedRows {
  static constexpr int kMaxRows = 4096;
  int base_x, base_y;
  bool has_bits;
  std::uint64_t bits[kMaxRows];
  RowSpan spans[kMaxRows];
};

// The rectangle around the tiles of `window` that may hold a pixel with N < z^2, z > 0; empty if
// there is none. Conservative: interval bounds of the record's linear forms over the box of each
// tile's rays, in the tile's own frame.
HWY_INLINE TileWindow TouchedTiles(const TileGrid& grid, const float* r, const TileWindow& window,
                                   TouchedRows* rows) {
  const FloatTag d;
  const auto zero = hn::Zero(d);
  TileWindow hits = {window.x1, window.x0, window.y1, window.y0};
  FloatVec forms[9];
  for (int k = 0; k < 9; ++k) forms[k] = hn::Set(d, r[k]);
  rows->base_x = window.x0;
  rows->base_y = window.y0;
  rows->has_bits = window.x1 - window.x0 <= 64;
  for (int row = window.y0; row < window.y1; ++row) {
    const int r_index = row - window.y0;
    rows->bits[r_index] = 0;
    rows->spans[r_index] = {0, 0};
    for (int column = window.x0; column < window.x1; column += kLanes) {
      const std::size_t tile = static_cast<std::size_t>(row) * grid.tiles_x + column;
      const auto load = [&](const AlignedVector<float>& array) HWY_ATTR {
        return hn::LoadU(d, &array[tile]);
      };
      FloatVec axes[9];
      for (int k = 0; k < 9; ++k) axes[k] = load(grid.frame[k]);
      const auto cs = load(grid.box[0]), ct = load(grid.box[1]);
      const auto hs = load(grid.box[2]), ht = load(grid.box[3]);
      // Form at the box's centre and how far it can stray inside the box.
      FloatVec value[3], spread[3];
      for (int form = 0; form < 3; ++form) {
        const auto dot = [&](int axis) HWY_ATTR {
          return hn::MulAdd(forms[3 * form], axes[3 * axis],
                            hn::MulAdd(forms[3 * form + 1], axes[3 * axis + 1],
                                       hn::Mul(forms[3 * form + 2], axes[3 * axis + 2])));
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
      const int rest = window.x1 - column;
      if (rest < kLanes) bits &= (std::uint64_t{1} << rest) - 1;
      if (bits == 0) continue;
      if (rows->has_bits) rows->bits[r_index] |= bits << (column - window.x0);
      const int first = column + static_cast<int>(__builtin_ctzll(bits));
      const int last = column + 64 - static_cast<int>(__builtin_clzll(bits));
      RowSpan& span = rows->spans[r_index];
      if (span.begin == span.end) span.begin = static_cast<std::uint16_t>(first);
      span.end = static_cast<std::uint16_t>(last);
      hits.x0 = HWY_MIN(hits.x0, first);
      hits.x1 = HWY_MAX(hits.x1, last);
      hits.y0 = HWY_MIN(hits.y0, row);
      hits.y1 = row + 1;
    }
  }
  return hits;
}

HWY_INLINE TileRect RectOf(const TileWindow& hits, const TouchedRows& rows,
                           std::vector<RowSpan>* spans) {
  TileRect rect;
  if (hits.empty()) return rect;
  rect.x0 = static_cast<std::uint16_t>(hits.x0);
  rect.x1 = static_cast<std::uint16_t>(hits.x1);
  rect.y0 = static_cast<std::uint16_t>(hits.y0);
  rect.y1 = static_cast<std::uint16_t>(hits.y1);
  if (rect.Area() > TileRect::kMaxMasked) {
    rect.tiles = spans->size();
    for (int y = hits.y0; y < hits.y1; ++y) spans->push_back(rows.spans[y - rows.base_y]);
    return rect;
  }
  const int width = hits.x1 - hits.x0;
  for (int y = hits.y0; y < hits.y1; ++y) {
    const int row = y - rows.base_y;
    std::uint64_t bits = rows.bits[row] >> (hits.x0 - rows.base_x);
    if (!rows.has_bits) {
      const RowSpan span = rows.spans[row];
      const int count = span.end - span.begin;
      bits = count == 0 ? 0 : (~std::uint64_t{0} >> (64 - count)) << (span.begin - hits.x0);
    }
    rect.tiles |= bits << ((y - hits.y0) * width);
  }
  return rect;
}

// Looks at every tile of the image.
HWY_INLINE TileRect ExactTileRect(const TileGrid& grid, const float* r, TouchedRows* rows,
                                  std::vector<RowSpan>* spans) {
  const TileWindow window = {0, grid.tiles_x, 0, grid.tiles_y};
  return RectOf(TouchedTiles(grid, r, window, rows), *rows, spans);
}

// Looks inside a window that is known to hold the footprint.
HWY_INLINE TileRect BoundedTileRect(const TileGrid& grid, const float* r, const TileWindow& window,
                                    TouchedRows* rows, std::vector<RowSpan>* spans) {
  if (window.x1 - window.x0 == 1 && window.y1 - window.y0 == 1) {
    return {static_cast<std::uint16_t>(window.x0), static_cast<std::uint16_t>(window.x1),
            static_cast<std::uint16_t>(window.y0), static_cast<std::uint16_t>(window.y1), 1};
  }
  return RectOf(TouchedTiles(grid, r, window, rows), *rows, spans);
}

// Looks around `guess` and further out for as long as the footprint reaches the edge of what was
// looked at: a footprint is connected, so nothing of it lies beyond a margin it does not touch.
HWY_INLINE TileRect GrownTileRect(const TileGrid& grid, const float* r, const TileWindow& guess,
                                  TouchedRows* rows, std::vector<RowSpan>* spans) {
  TileWindow window = {guess.x0 - 1, guess.x1 + 1, guess.y0 - 1, guess.y1 + 1};
  for (int step = 2;; step *= 2) {
    window.x0 = HWY_MAX(window.x0, 0);
    window.y0 = HWY_MAX(window.y0, 0);
    window.x1 = HWY_MIN(window.x1, grid.tiles_x);
    window.y1 = HWY_MIN(window.y1, grid.tiles_y);
    const TileWindow hits = TouchedTiles(grid, r, window, rows);
    if (hits.empty()) return {};
    const bool left = hits.x0 == window.x0 && window.x0 > 0;
    const bool right = hits.x1 == window.x1 && window.x1 < grid.tiles_x;
    const bool up = hits.y0 == window.y0 && window.y0 > 0;
    const bool down = hits.y1 == window.y1 && window.y1 < grid.tiles_y;
    if (!(left || right || up || down)) return RectOf(hits, *rows, spans);
    if (left) window.x0 -= step;
    if (right) window.x1 += step;
    if (up) window.y0 -= step;
    if (down) window.y1 += step;
  }
}

// The tiles that hold a pixel centre within the box centre +- extent (pixels).
HWY_INLINE TileWindow EllipseTiles(const TileGrid& grid, float u, float v, float extent_u,
                                    float extent_v) {
  // The outermost pixel centres lie half a pixel inside the image's edge.
  const auto tile_of = [](float pixel, int size) {
    const float limit = static_cast<float>(size) - 0.5f;
    const float clamped = pixel < 0.5f ? 0.5f : pixel > limit ? limit : pixel;
    return static_cast<int>(clamped) / kTileSize;
  };
  const int x0 = tile_of(u - extent_u, grid.width), x1 = tile_of(u + extent_u, grid.width);
  const int y0 = tile_of(v - extent_v, grid.height), y1 = tile_of(v + extent_v, grid.height);
  return {x0, x1 + 1, y0, y1 + 1};
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
