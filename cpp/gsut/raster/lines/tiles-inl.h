// Which tiles of a line grid a Gaussian may touch: down the pyramid of bounds, never one too few.

#if defined(GSUT_RASTER_LINES_TILES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_TILES_INL_H_
#undef GSUT_RASTER_LINES_TILES_INL_H_
#else
#define GSUT_RASTER_LINES_TILES_INL_H_
#endif

#include "gsut/raster/lines/pair-inl.h"
#include "gsut/raster/tile_rect-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// A bundle a lane, from the values of a group.
struct BundleLanes {
  Lane axes[9], center[4], half[4], slide, state;

  HWY_INLINE BundleLanes(const float* group, int first) {
    const FloatTag d;
    const auto load = [&](int k) HWY_ATTR {
      return Lane(hn::Load(d, group + k * LineLevel::kGroup + first));
    };
    for (int k = 0; k < 9; ++k) axes[k] = load(LineBundle::kD + k);
    for (int k = 0; k < 4; ++k) {
      center[k] = load(LineBundle::kCenter + k);
      half[k] = load(LineBundle::kHalf + k);
    }
    slide = load(LineBundle::kSlide);
    state = load(LineBundle::kState);
  }
};

// Whether lines may pass the sphere of this radius around the mean: cheaper than MayHit, and as
// tight where bundles are larger than the Gaussian.
HWY_INLINE LaneMask MayPass(const GaussianLanes& g, Lane radius, const BundleLanes& bundle) {
  constexpr double kRounding = 1e-6;
  const Lane d = Dot3(g.mean, bundle.axes);
  const Lane m1 = Dot3(g.mean, bundle.axes + 3), m2 = Dot3(g.mean, bundle.axes + 6);
  const Lane slack = Lane(kRounding) * (Abs(m1) + Abs(m2) + Abs(d));
  const auto least = [&](Lane m, int of_origin, int of_direction) HWY_ATTR {
    const Lane at = (m - bundle.center[of_origin]) - d * bundle.center[of_direction];
    const Lane half = bundle.half[of_origin] + Abs(d) * bundle.half[of_direction] + slack;
    return Max(Abs(at) - half, Lane(0.0));
  };
  const Lane a = least(m1, 0, 2), b = least(m2, 1, 3);
  const Lane s = Abs(bundle.center[2]) + bundle.half[2], t = Abs(bundle.center[3]) + bundle.half[3];
  // A line at (A, B) in the plane through the mean passes it at no less than |(A, B)| over the
  // length of (s, t, 1).
  const Lane most = radius * radius * (Lane(1.0) + s * s + t * t);
  constexpr double kRelative = 1e-5;
  const LaneMask misses = a * a + b * b > most * Lane(1.0 + kRelative);
  return NotMask(OrMask(misses, d + radius + slack < bundle.slide));
}

// Bit i set where node i of a group may hold a line that hits the Gaussian (in every lane of g).
// exact: by may_hit(g, bundle), else by the sphere around it.
template <class MayHitBundle>
HWY_INLINE std::uint64_t TouchedNodes(const MayHitBundle& may_hit, const GaussianLanes& g,
                                      Lane radius, const float* group, bool exact) {
  const FloatTag d;
  std::uint64_t touched = 0;
  for (int i = 0; i < LineLevel::kGroup; i += kLanes) {
    const BundleLanes bundle(group, i);
    LaneMask hit = AndMask(MayPass(g, radius, bundle), bundle.state > Lane(LineBundle::kEmpty));
    if (exact && !hn::AllFalse(d, hit.m)) {
      hit = AndMask(hit, may_hit(g, bundle));
    }
    touched |= MaskBits(OrMask(hit, bundle.state > Lane(LineBundle::kNarrow)).m) << i;
  }
  return touched;
}

// The rectangle around the tiles of `window` that the Gaussian may touch; empty if none.
// may_hit(g, bundle): whether lines of a bundle may hit the Gaussian itself.
template <class MayHitBundle>
HWY_INLINE TileWindow TouchWindow(const LineGrid& grid, const MayHitBundle& may_hit,
                                  const GaussianLanes& g, TileWindow window, TouchedRows* rows) {
  struct Place {
    int level, x, y;
  };
  // Each level leaves at most 16 groups below one open: enough for images of 4^10 tiles.
  constexpr int kMaxOpen = 160;
  Place open[kMaxOpen];
  int count = 0;
  const Lane radius = g.k * Sqrt(Max(g.variance[0], Max(g.variance[1], g.variance[2])));
  open[count++] = {static_cast<int>(grid.levels.size()) - 1, 0, 0};
  TileWindow hits = {window.x1, window.x0, window.y1, window.y0};
  while (count > 0) {
    const Place place = open[--count];
    const LineLevel& level = grid.levels[static_cast<std::size_t>(place.level)];
    std::uint64_t touched =
        TouchedNodes(may_hit, g, radius, level.Group(place.x, place.y), place.level == 0);
    if (place.level == 0) {
      AddTouched(touched, place.x, place.y, window, rows, &hits);
      continue;
    }
    for (; touched != 0; touched &= touched - 1) {
      const int node = __builtin_ctzll(touched);
      open[count++] = {place.level - 1, 4 * place.x + node % 4, 4 * place.y + node / 4};
    }
  }
  return hits;
}

// A function, so that Gaussians keep their registers.
inline HWY_NOINLINE TileWindow TouchFlat(const LineGrid& grid, GaussianLanes g, TileWindow window,
                                         TouchedRows* rows) {
  const auto may_hit = [](const GaussianLanes& of, const BundleLanes& bundle) HWY_ATTR {
    return MayHitFlat(PlaceFlat(of, bundle.axes), bundle.center, bundle.half);
  };
  return TouchWindow(grid, may_hit, g, window, rows);
}

// The tiles of the Gaussian with this record; all of them that it may touch.
HWY_INLINE TileRect LineTileRect(const RasterTask& task, const LineGrid& grid, const float* row,
                                 TouchedRows* rows, std::vector<RowSpan>* spans) {
  const auto load = [&](int k) HWY_ATTR { return Lane(row[k]); };
  const GaussianLanes g = LoadGaussians(task, load);
  const TileWindow window = {0, grid.tiles.tiles_x, 0, grid.tiles.tiles_y};
  rows->Clear(window);
  if (HWY_UNLIKELY(IsFlat(task.gaussians.primitive))) {
    return RectOf(TouchFlat(grid, g, window, rows), *rows, spans);
  }
  const auto may_hit = [](const GaussianLanes& of, const BundleLanes& bundle) HWY_ATTR {
    return MayHit(PlaceInFrame(of, bundle.axes), bundle.center, bundle.half, bundle.slide);
  };
  return RectOf(TouchWindow(grid, may_hit, g, window, rows), *rows, spans);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
