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

// What was found row by row: the tiles' bits from column `base_x` on, for windows of up to 64 tiles
// in width, and the span, for any.
struct TouchedRows {
  static constexpr int kMaxRows = 4096;
  int base_x, base_y;
  bool has_bits;
  std::uint64_t bits[kMaxRows];
  RowSpan spans[kMaxRows];

  HWY_INLINE void Clear(const TileWindow& window) {
    base_x = window.x0;
    base_y = window.y0;
    has_bits = window.x1 - window.x0 <= 64;
    for (int row = 0; row < window.y1 - window.y0; ++row) {
      bits[row] = 0;
      spans[row] = {0, 0};
    }
  }
};

// How far rounding may put each of a record's linear forms off; 3 floats a lane.
struct FormSlack {
  HWY_ALIGN float lanes[3][kLanes];

  HWY_INLINE FormSlack(const Lane* a, const Lane* b, const Lane* c) {
    constexpr float kRounding = 0x1p-21f;
    const Lane* forms[3] = {a, b, c};
    for (int form = 0; form < 3; ++form) {
      const Lane* v = forms[form];
      hn::Store(((Abs(v[0]) + (Abs(v[1]) + Abs(v[2]))) * Lane(kRounding)).v, FloatTag(),
                lanes[form]);
    }
  }
};

// The linear forms of the record of one lane, in every lane.
struct FormLanes {
  FloatVec v[9], slack[3];
  HWY_INLINE FormLanes(const float* r, const FormSlack& slacks, int lane) {
    for (int k = 0; k < 9; ++k) v[k] = hn::Set(FloatTag(), r[k]);
    for (int form = 0; form < 3; ++form) {
      slack[form] = hn::Set(FloatTag(), slacks.lanes[form][lane]);
    }
  }
};

// Which boxes of rays may hold one with N < z^2, z > 0, a box a lane: conservative interval bounds
// of the forms. load(k): value k of RayBox.
template <class Load>
// The least of |p| and |q| and the greatest z, each over the whole box, may belong to different
// rays: the test keeps a box too many, never one too few.
HWY_INLINE FloatMask TouchedBoxes(const FormLanes& forms, Load&& load) {
  const auto zero = hn::Zero(FloatTag());
  FloatVec box[RayBox::kSize];
  for (int k = 0; k < RayBox::kSize; ++k) box[k] = load(k);
  // Form at the box's centre and how far it can stray inside the box.
  FloatVec value[3], spread[3];
  for (int form = 0; form < 3; ++form) {
    const auto dot = [&](int vector) HWY_ATTR {
      return hn::MulAdd(forms.v[3 * form], box[vector],
                        hn::MulAdd(forms.v[3 * form + 1], box[vector + 1],
                                   hn::Mul(forms.v[3 * form + 2], box[vector + 2])));
    };
    value[form] = dot(RayBox::kCenter);
    spread[form] = hn::Add(hn::Add(hn::Abs(dot(RayBox::kHalfS)), hn::Abs(dot(RayBox::kHalfT))),
                           forms.slack[form]);
  }
  // A centre that is no number compares as false, whichever way a maximum takes it.
  const auto p = hn::Max(hn::Sub(hn::Abs(value[0]), spread[0]), zero);
  const auto q = hn::Max(hn::Sub(hn::Abs(value[1]), spread[1]), zero);
  const auto z = hn::Max(hn::Add(value[2], spread[2]), zero);
  return hn::Lt(hn::MulAdd(p, p, hn::Mul(q, q)), hn::Mul(z, z));
}

// Adds the touched tiles of one cell (bit 4 row + column of `touched`), as far as they lie in the
// window, to rows and hits.
HWY_INLINE void AddTouched(std::uint64_t touched, int cell_x, int cell_y, const TileWindow& window,
                           TouchedRows* rows, TileWindow* hits) {
  if (touched == 0) return;
  const int x0 = cell_x * kCellSize;
  for (int i = 0; i < kCellSize; ++i) {
    const int y = cell_y * kCellSize + i;
    unsigned bits = static_cast<unsigned>(touched >> (i * kCellSize)) & 0xFu;
    if (x0 < window.x0) bits &= 0xFu << (window.x0 - x0);
    if (x0 + kCellSize > window.x1) bits &= 0xFu >> (x0 + kCellSize - window.x1);
    if (bits == 0 || y < window.y0 || y >= window.y1) continue;
    const int first = x0 + __builtin_ctz(bits);
    const int last = x0 + 32 - __builtin_clz(bits);
    const int row = y - window.y0;
    if (rows->has_bits) {
      rows->bits[row] |= static_cast<std::uint64_t>(bits >> (first - x0)) << (first - window.x0);
    }
    RowSpan& span = rows->spans[row];
    if (span.begin == span.end) {
      span = {static_cast<std::uint16_t>(first), static_cast<std::uint16_t>(last)};
    } else {
      span.begin = static_cast<std::uint16_t>(HWY_MIN(static_cast<int>(span.begin), first));
      span.end = static_cast<std::uint16_t>(HWY_MAX(static_cast<int>(span.end), last));
    }
    hits->x0 = HWY_MIN(hits->x0, first);
    hits->x1 = HWY_MAX(hits->x1, last);
    hits->y0 = HWY_MIN(hits->y0, y);
    hits->y1 = HWY_MAX(hits->y1, y + 1);
  }
}

// The touched tiles of the group that begins at a tile: bit 4 row + column.
HWY_INLINE std::uint64_t TouchedInGroup(const TileGrid& grid, const FormLanes& forms, int x0,
                                        int y0) {
  const FloatTag d;
  const std::size_t group =
      static_cast<std::size_t>(y0 / kGroupStep) * grid.groups_x + x0 / kGroupStep;
  const float* tiles = &grid.group_tiles[group * RayBox::kSize * kCellTiles];
  std::uint64_t touched = 0;
  for (int i = 0; i < kCellTiles; i += kLanes) {
    const auto load = [&](int k) HWY_ATTR { return hn::Load(d, tiles + k * kCellTiles + i); };
    touched |= MaskBits(TouchedBoxes(forms, load)) << i;
  }
  return touched;
}

HWY_INLINE void TouchCell(const TileGrid& grid, const FormLanes& forms, int cell_x, int cell_y,
                          const TileWindow& window, TouchedRows* rows, TileWindow* hits) {
  const std::uint64_t touched = TouchedInGroup(grid, forms, cell_x * kCellSize, cell_y * kCellSize);
  AddTouched(touched, cell_x, cell_y, window, rows, hits);
}

// The rectangle around the tiles of `window` that the footprint may touch; empty if none.
HWY_INLINE TileWindow TouchedTiles(const TileGrid& grid, const FormLanes& forms,
                                   const TileWindow& window, TouchedRows* rows) {
  TileWindow hits = {window.x1, window.x0, window.y1, window.y0};
  rows->Clear(window);
  for (int y = window.y0 / kCellSize; y <= (window.y1 - 1) / kCellSize; ++y) {
    for (int x = window.x0 / kCellSize; x <= (window.x1 - 1) / kCellSize; ++x) {
      TouchCell(grid, forms, x, y, window, rows, &hits);
    }
  }
  return hits;
}

// Up to 64 tiles keep a bit each. More keep one span a row, which also fills gaps within the row:
// tiles where the blend then finds no pixel.
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
    std::uint64_t bits = 0;
    if (rows.has_bits) {
      bits = rows.bits[row] >> (hits.x0 - rows.base_x);
    } else if (const RowSpan span = rows.spans[row]; span.end != span.begin) {
      bits = (~std::uint64_t{0} >> (64 - (span.end - span.begin))) << (span.begin - hits.x0);
    }
    rect.tiles |= bits << ((y - hits.y0) * width);
  }
  return rect;
}

// Looks at every cell of the image, and into the touched ones.
HWY_INLINE TileRect ExactTileRect(const TileGrid& grid, const FormLanes& forms, TouchedRows* rows,
                                  std::vector<RowSpan>* spans) {
  const FloatTag d;
  const TileWindow window = {0, grid.tiles_x, 0, grid.tiles_y};
  TileWindow hits = {window.x1, window.x0, window.y1, window.y0};
  rows->Clear(window);
  const int cells = grid.num_cells();
  for (int first = 0; first < cells; first += kLanes) {
    const auto load = [&](int k) HWY_ATTR {
      return hn::LoadU(d, &grid.cell_boxes[k][static_cast<std::size_t>(first)]);
    };
    const auto wide = hn::LoadU(d, &grid.cell_wide[static_cast<std::size_t>(first)]);
    std::uint64_t bits = MaskBits(hn::Or(TouchedBoxes(forms, load), hn::Gt(wide, hn::Zero(d))));
    if (cells - first < kLanes) bits &= (std::uint64_t{1} << (cells - first)) - 1;
    for (; bits != 0; bits &= bits - 1) {
      const int cell = first + static_cast<int>(__builtin_ctzll(bits));
      TouchCell(grid, forms, cell % grid.cells_x, cell / grid.cells_x, window, rows, &hits);
    }
  }
  return RectOf(hits, *rows, spans);
}

// Most windows lie in one group, or in 2 x 2: their tiles fit into one word, a byte a row, which
// needs no rows.
struct TileWord {
  int base_x = 0, base_y = 0;  // the first tile of the groups
  std::uint64_t bits = 0;

  TileWord() = default;

  static HWY_INLINE int BaseOf(int tile) { return tile / kGroupStep * kGroupStep; }
  static HWY_INLINE bool Holds(const TileWindow& window) {
    return window.x1 - BaseOf(window.x0) <= 8 && window.y1 - BaseOf(window.y0) <= 8;
  }

  // The touched tiles of a window that it holds.
  HWY_INLINE TileWord(const TileGrid& grid, const FormLanes& forms, const TileWindow& window)
      : base_x(BaseOf(window.x0)), base_y(BaseOf(window.y0)) {
    static_assert(2 * kCellSize == 8);
    for (int y = base_y; y < window.y1; y += kCellSize) {
      for (int x = base_x; x < window.x1; x += kCellSize) {
        const std::uint64_t group = TouchedInGroup(grid, forms, x, y);
        const std::uint64_t by_bytes =
            (group & 0xF) | (group & 0xF0) << 4 | (group & 0xF00) << 8 | (group & 0xF000) << 12;
        bits |= by_bytes << (8 * (y - base_y) + (x - base_x));
      }
    }
    constexpr std::uint64_t kEveryRow = 0x0101010101010101u;  // one bit a byte: repeats a row
    constexpr std::uint64_t kAll = ~std::uint64_t{0};
    const std::uint64_t columns =
        (0xFFu << (window.x0 - base_x)) & (0xFFu >> (base_x + 8 - window.x1));
    bits &= columns * kEveryRow;
    bits &= kAll << (8 * (window.y0 - base_y)) & kAll >> (8 * (base_y + 8 - window.y1));
  }

  HWY_INLINE TileWindow Hits() const {
    if (bits == 0) return {};
    std::uint64_t columns = bits | bits >> 32;
    columns |= columns >> 16;
    columns = (columns | columns >> 8) & 0xFF;
    return {base_x + __builtin_ctzll(columns), base_x + 64 - __builtin_clzll(columns),
            base_y + __builtin_ctzll(bits) / 8, base_y + 8 - __builtin_clzll(bits) / 8};
  }

  HWY_INLINE TileRect Rect(const TileWindow& hits) const {
    TileRect rect = {static_cast<std::uint16_t>(hits.x0), static_cast<std::uint16_t>(hits.x1),
                     static_cast<std::uint16_t>(hits.y0), static_cast<std::uint16_t>(hits.y1), 0};
    const int width = hits.x1 - hits.x0;
    const std::uint64_t row_bits = (std::uint64_t{1} << width) - 1;
    for (int y = hits.y0; y < hits.y1; ++y) {
      const int offset = 8 * (y - base_y) + hits.x0 - base_x;
      rect.tiles |= (bits >> offset & row_bits) << ((y - hits.y0) * width);
    }
    return rect;
  }
};

// Looks inside a window that is the bounding box of the footprint, or hardly larger.
HWY_INLINE TileRect BoundedTileRect(const TileGrid& grid, const FormLanes& forms,
                                    const TileWindow& window, TouchedRows* rows,
                                    std::vector<RowSpan>* spans) {
  // Of one row or column the footprint, which is connected, touches every tile.
  const int width = window.x1 - window.x0, height = window.y1 - window.y0;
  if ((width == 1 || height == 1) &&
      static_cast<unsigned>(width * height) <= TileRect::kMaxMasked) {
    return {static_cast<std::uint16_t>(window.x0), static_cast<std::uint16_t>(window.x1),
            static_cast<std::uint16_t>(window.y0), static_cast<std::uint16_t>(window.y1),
            ~std::uint64_t{0} >> (64 - width * height)};
  }
  if (TileWord::Holds(window)) {
    const TileWord word(grid, forms, window);
    return word.Rect(word.Hits());
  }
  return RectOf(TouchedTiles(grid, forms, window, rows), *rows, spans);
}

// Looks around `guess` and further out for as long as the footprint reaches the edge of what was
// looked at: a footprint is connected, so nothing of it lies beyond a margin it does not touch.
HWY_INLINE TileRect GrownTileRect(const TileGrid& grid, const FormLanes& forms,
                                  const TileWindow& guess, TouchedRows* rows,
                                  std::vector<RowSpan>* spans) {
  TileWindow window = {guess.x0 - 1, guess.x1 + 1, guess.y0 - 1, guess.y1 + 1};
  for (int step = 2;; step *= 2) {
    window.x0 = HWY_MAX(window.x0, 0);
    window.y0 = HWY_MAX(window.y0, 0);
    window.x1 = HWY_MIN(window.x1, grid.tiles_x);
    window.y1 = HWY_MIN(window.y1, grid.tiles_y);
    const bool in_word = TileWord::Holds(window);
    TileWord word;
    if (in_word) word = TileWord(grid, forms, window);
    const TileWindow hits = in_word ? word.Hits() : TouchedTiles(grid, forms, window, rows);
    if (hits.empty()) return {};
    const bool left = hits.x0 == window.x0 && window.x0 > 0;
    const bool right = hits.x1 == window.x1 && window.x1 < grid.tiles_x;
    const bool up = hits.y0 == window.y0 && window.y0 > 0;
    const bool down = hits.y1 == window.y1 && window.y1 < grid.tiles_y;
    if (!(left || right || up || down)) {
      return in_word ? word.Rect(hits) : RectOf(hits, *rows, spans);
    }
    // Twice as far at each turn: the cost of a wrong guess stays a small multiple of the
    // footprint's.
    if (left) window.x0 -= step;
    if (right) window.x1 += step;
    if (up) window.y0 -= step;
    if (down) window.y1 += step;
  }
}

// The tiles that hold a pixel centre within the boxes centre +- extent (pixels), a box a lane.
// Truncation towards zero is a floor here, as pixels are clamped into the image first.
struct EllipseTiles {
  static constexpr int kTileBits = 4;
  HWY_ALIGN std::int32_t x0[kLanes], x1[kLanes], y0[kLanes], y1[kLanes];

  HWY_INLINE EllipseTiles(const TileGrid& grid, Lane u, Lane v, Lane extent_u, Lane extent_v) {
    Range(u, extent_u, grid.width, x0, x1);
    Range(v, extent_v, grid.height, y0, y1);
  }
  HWY_INLINE TileWindow operator[](int lane) const {
    return {x0[lane], x1[lane], y0[lane], y1[lane]};
  }

 private:
  static HWY_INLINE void Range(Lane center, Lane extent, int size, std::int32_t* begin,
                               std::int32_t* end) {
    static_assert(kTileSize == 1 << kTileBits);
    const hn::RebindToSigned<FloatTag> di;
    // The outermost pixel centres lie half a pixel inside the image's edge.
    const Lane first(0.5f), last(static_cast<float>(size) - 0.5f);
    const auto tile_of = [&](Lane pixel) HWY_ATTR {
      return hn::ShiftRight<kTileBits>(hn::ConvertTo(di, Min(Max(pixel, first), last).v));
    };
    hn::Store(tile_of(center - extent), di, begin);
    hn::Store(hn::Add(tile_of(center + extent), hn::Set(di, 1)), di, end);
  }
};

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
