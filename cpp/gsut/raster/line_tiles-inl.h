// Which tiles of a line grid a Gaussian may touch: down the pyramid of bounds, never one too few.

#if defined(GSUT_RASTER_LINE_TILES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINE_TILES_INL_H_
#undef GSUT_RASTER_LINE_TILES_INL_H_
#else
#define GSUT_RASTER_LINE_TILES_INL_H_
#endif

#include "gsut/raster/line_pair-inl.h"
#include "gsut/raster/tile_rect-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Bit i set where node i of a group may hold a line that hits the Gaussian (in every lane of g).
HWY_INLINE std::uint64_t TouchedNodes(const GaussianLanes& g, const float* group) {
  const FloatTag d;
  std::uint64_t touched = 0;
  for (int i = 0; i < LineLevel::kGroup; i += kLanes) {
    const auto load = [&](int k)
                          HWY_ATTR { return Lane(hn::Load(d, group + k * LineLevel::kGroup + i)); };
    Lane axes[9], center[4], half[4];
    for (int k = 0; k < 9; ++k) axes[k] = load(LineBundle::kD + k);
    for (int k = 0; k < 4; ++k) {
      center[k] = load(LineBundle::kCenter + k);
      half[k] = load(LineBundle::kHalf + k);
    }
    const Lane state = load(LineBundle::kState);
    const LinePair pair = PlaceInFrame(g, axes);
    const LaneMask hit = MayHit(pair, center, half, load(LineBundle::kSlide));
    const LaneMask narrow = AndMask(hit, state > Lane(LineBundle::kEmpty));
    touched |= MaskBits(OrMask(narrow, state > Lane(LineBundle::kNarrow)).m) << i;
  }
  return touched;
}

// Adds the tiles under one group of a level.
HWY_INLINE void TouchGroup(const LineGrid& grid, const GaussianLanes& g, const TileWindow& window,
                           TouchedRows* rows, TileWindow* hits) {
  struct Place {
    int level, x, y;
  };
  // Each level leaves at most 16 groups below one open: enough for images of 4^10 tiles.
  constexpr int kMaxOpen = 160;
  Place open[kMaxOpen];
  int count = 0;
  open[count++] = {static_cast<int>(grid.levels.size()) - 1, 0, 0};
  while (count > 0) {
    const Place place = open[--count];
    const LineLevel& level = grid.levels[static_cast<std::size_t>(place.level)];
    std::uint64_t touched = TouchedNodes(g, level.Group(place.x, place.y));
    if (place.level == 0) {
      AddTouched(touched, place.x, place.y, window, rows, hits);
      continue;
    }
    for (; touched != 0; touched &= touched - 1) {
      const int node = __builtin_ctzll(touched);
      open[count++] = {place.level - 1, 4 * place.x + node % 4, 4 * place.y + node / 4};
    }
  }
}

// The tiles of the Gaussian with this record; all of them that it may touch.
HWY_INLINE TileRect LineTileRect(const LineGrid& grid, const float* row, float log2_alpha_min,
                                 float max_cutoff, TouchedRows* rows, std::vector<RowSpan>* spans) {
  const auto load = [&](int k) HWY_ATTR { return Lane(row[k]); };
  const GaussianLanes g = LoadGaussians(log2_alpha_min, max_cutoff, load);
  const TileWindow window = {0, grid.tiles.tiles_x, 0, grid.tiles.tiles_y};
  TileWindow hits = {window.x1, window.x0, window.y1, window.y0};
  rows->Clear(window);
  TouchGroup(grid, g, window, rows, &hits);
  return RectOf(hits, *rows, spans);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
