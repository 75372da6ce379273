// Builds the tiles of a camera from its ray table, in double.
#include "gsut/raster/tile_grid.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <list>
#include <mutex>

#include "gsut/base/parallel.h"
#include "gsut/raster/sharp_records.h"

namespace gsut {
namespace {

using Eigen::Vector3d;

// Smallest cosine between a ray and its tile's axis: beyond about 84 degrees s and t grow past 10
// and float loses digits.
constexpr double kMinCosine = 0.1;
// Boxes are widened by this factor so that rounding to float never shrinks them.
constexpr double kBoxMargin = 1.0001;
// Grids kept; a run uses one camera at three resolutions, a rig of eight cameras 24.
constexpr std::size_t kCacheSize = 64;

struct Box {
  double s0 = 1e30, s1 = -1e30, t0 = 1e30, t1 = -1e30;
  bool empty() const { return s0 > s1; }
  void Add(double s, double t) {
    s0 = std::min(s0, s);
    s1 = std::max(s1, s);
    t0 = std::min(t0, t);
    t1 = std::max(t1, t);
  }
  void Store(float* cs, float* ct, float* hs, float* ht) const {
    if (empty()) {
      *cs = *ct = *hs = *ht = 0.0f;
      return;
    }
    constexpr double kFloatEps = 1.2e-7;
    *cs = static_cast<float>(0.5 * (s0 + s1));
    *ct = static_cast<float>(0.5 * (t0 + t1));
    *hs = static_cast<float>(0.5 * (s1 - s0) * kBoxMargin + kFloatEps * std::abs(*cs));
    *ht = static_cast<float>(0.5 * (t1 - t0) * kBoxMargin + kFloatEps * std::abs(*ct));
  }
};

// The rays of a rectangle of pixels.
class PixelRays {
 public:
  PixelRays(const RayTable& rays, const TileGrid& grid, int x0, int y0, int size)
      : rays_(rays),
        width_(grid.width),
        x0_(x0),
        y0_(y0),
        x1_(std::min(x0 + size, grid.width)),
        y1_(std::min(y0 + size, grid.height)) {}

  // visit(x, y, ray) for each pixel that has one.
  template <class Visit>
  void ForEach(Visit&& visit) const {
    for (int y = y0_; y < y1_; ++y) {
      for (int x = x0_; x < x1_; ++x) {
        if (Valid(x, y)) visit(x, y, Ray(x, y));
      }
    }
  }

  // D: mean direction; E1: where rays go to the right; E2 = D x E1. False without any ray.
  bool Frame(Vector3d* d, Vector3d* e1, Vector3d* e2) const {
    Vector3d axis = Vector3d::Zero();
    Vector3d along = Vector3d::Zero();
    ForEach([&](int x, int y, const Vector3d& ray) {
      axis += ray;
      if (x + 1 < x1_ && Valid(x + 1, y)) along += Ray(x + 1, y) - ray;
    });
    const bool any = axis.squaredNorm() > 0;
    *d = any ? axis.normalized() : Vector3d::UnitZ();
    *e1 = along - *d * d->dot(along);
    if (!(e1->norm() > 1e-9)) *e1 = d->unitOrthogonal();
    e1->normalize();
    *e2 = d->cross(*e1);
    return any;
  }

 private:
  bool Valid(int x, int y) const {
    return rays_.valid[static_cast<std::size_t>(y) * width_ + x] != 0;
  }
  Vector3d Ray(int x, int y) const {
    return Eigen::Map<const Vector3d>(&rays_.rays[3 * (static_cast<std::size_t>(y) * width_ + x)]);
  }
  const RayTable& rays_;
  int width_, x0_, y0_, x1_, y1_;
};

RayBundle MakeBundle(const Vector3d& d, const Vector3d& e1, const Vector3d& e2, const Box& box) {
  RayBundle bundle;
  for (int k = 0; k < 3; ++k) {
    bundle.values[k] = static_cast<float>(d[k]);
    bundle.values[3 + k] = static_cast<float>(e1[k]);
    bundle.values[6 + k] = static_cast<float>(e2[k]);
  }
  box.Store(&bundle.values[RayBundle::kCenter], &bundle.values[RayBundle::kCenter + 1],
            &bundle.values[RayBundle::kHalf], &bundle.values[RayBundle::kHalf + 1]);
  bundle.values[RayBundle::kHasRay] = box.empty() ? 0.0f : 1.0f;
  return bundle;
}

// The gnomonic projection about D: s = r.E1 / r.D and t = r.E2 / r.D of each pixel's ray r. Linear
// forms of rays are then linear in s and t, whatever the lens: a box of (s, t) bounds them.
// Fills one tile; returns false if its rays spread too wide.
bool FillTile(const RayTable& rays, int tile, TileGrid* grid) {
  const int x0 = (tile % grid->tiles_x) * kTileSize;
  const int y0 = (tile / grid->tiles_x) * kTileSize;
  const PixelRays pixels(rays, *grid, x0, y0, kTileSize);
  Vector3d d, e1, e2;
  pixels.Frame(&d, &e1, &e2);
  const std::size_t first = static_cast<std::size_t>(tile) * kTilePixels;
  std::fill_n(&grid->s[first], kTilePixels, 0.0f);
  std::fill_n(&grid->t[first], kTilePixels, 0.0f);
  std::fill_n(&grid->start[first], kTilePixels, 0.0f);
  std::fill_n(&grid->length[first], kTilePixels, 1.0f);
  Box tile_box;
  std::vector<Box> block_boxes(static_cast<std::size_t>(grid->blocks));
  bool narrow = true;
  std::uint64_t alive = 0;
  pixels.ForEach([&](int x, int y, const Vector3d& ray) {
    // About the axis of the tile s and t are small: float keeps more digits of a ray than its unit
    // vector would. A pixel without a ray keeps start 0 and blends nothing.
    const double cosine = ray.dot(d);
    if (!(cosine > kMinCosine)) {
      narrow = false;
      return;
    }
    const int offset = grid->PixelOffset(x - x0, y - y0);
    const std::size_t i = first + static_cast<std::size_t>(offset);
    const double s = ray.dot(e1) / cosine;
    const double t = ray.dot(e2) / cosine;
    grid->s[i] = static_cast<float>(s);
    grid->t[i] = static_cast<float>(t);
    grid->length[i] = static_cast<float>(std::sqrt(1.0 + s * s + t * t));
    grid->start[i] = 1.0f;
    const int block = offset / grid->lanes;
    alive |= std::uint64_t{1} << block;
    tile_box.Add(s, t);
    block_boxes[static_cast<std::size_t>(block)].Add(s, t);
  });
  grid->alive[static_cast<std::size_t>(tile)] = alive;
  grid->bundles[static_cast<std::size_t>(tile)] = MakeBundle(d, e1, e2, tile_box);
  SplitDirection(d.data(), &grid->center[static_cast<std::size_t>(tile) * kDirectionSize]);
  float* boxes = &grid->block_box[static_cast<std::size_t>(tile) * 4 * grid->block_stride];
  std::fill_n(boxes, 4 * grid->block_stride, 0.0f);
  for (int b = 0; b < grid->blocks; ++b) {
    block_boxes[static_cast<std::size_t>(b)].Store(&boxes[b], &boxes[grid->block_stride + b],
                                                   &boxes[2 * grid->block_stride + b],
                                                   &boxes[3 * grid->block_stride + b]);
  }
  return narrow;
}

// Gathers the boxes of a group's tiles; there are no rays beyond the image.
void FillGroup(int group, TileGrid* grid) {
  const int x0 = (group % grid->groups_x) * kGroupStep;
  const int y0 = (group / grid->groups_x) * kGroupStep;
  constexpr std::size_t kGroupFloats = std::size_t{RayBox::kSize} * kCellTiles;
  float* tiles = &grid->group_tiles[static_cast<std::size_t>(group) * kGroupFloats];
  std::fill_n(tiles, kGroupFloats, std::numeric_limits<float>::quiet_NaN());
  for (int y = y0; y < std::min(y0 + kCellSize, grid->tiles_y); ++y) {
    for (int x = x0; x < std::min(x0 + kCellSize, grid->tiles_x); ++x) {
      const RayBox box(grid->bundles[static_cast<std::size_t>(y) * grid->tiles_x + x]);
      const int place = (y - y0) * kCellSize + x - x0;
      for (int k = 0; k < RayBox::kSize; ++k) tiles[k * kCellTiles + place] = box.values[k];
    }
  }
}

// Makes a cell's own box.
void FillCell(const RayTable& rays, int cell, TileGrid* grid) {
  const int x0 = (cell % grid->cells_x) * kCellSize;
  const int y0 = (cell / grid->cells_x) * kCellSize;
  const PixelRays pixels(rays, *grid, x0 * kTileSize, y0 * kTileSize, kCellSize * kTileSize);
  Vector3d d, e1, e2;
  pixels.Frame(&d, &e1, &e2);
  Box box;
  bool wide = false;
  pixels.ForEach([&](int, int, const Vector3d& ray) {
    const double cosine = ray.dot(d);
    if (!(cosine > kMinCosine)) {
      wide = true;
    } else {
      box.Add(ray.dot(e1) / cosine, ray.dot(e2) / cosine);
    }
  });
  const RayBox bounds(MakeBundle(d, e1, e2, box));
  for (int k = 0; k < RayBox::kSize; ++k) {
    grid->cell_boxes[k][static_cast<std::size_t>(cell)] = bounds.values[k];
  }
  grid->cell_wide[static_cast<std::size_t>(cell)] = wide ? 1.0f : 0.0f;
}

// Three sizes of boxes around rays, each for one search: blocks of lanes inside a tile, tiles in
// groups of 4 x 4 beside each other for one vector test, and cells of 4 x 4 tiles for Gaussians
// whose footprint no ellipse bounds.
std::shared_ptr<const TileGrid> BuildTiles(const Camera& camera, int lanes) {
  auto grid = std::make_shared<TileGrid>();
  grid->width = camera.width();
  grid->height = camera.height();
  grid->tiles_x = (grid->width + kTileSize - 1) / kTileSize;
  grid->tiles_y = (grid->height + kTileSize - 1) / kTileSize;
  grid->lanes = lanes;
  grid->blocks = kTilePixels / lanes;
  grid->block_stride = (grid->blocks + lanes - 1) / lanes * lanes;
  const std::size_t tiles = static_cast<std::size_t>(grid->num_tiles());
  for (AlignedVector<float>* v : {&grid->s, &grid->t, &grid->start, &grid->length}) {
    v->resize(tiles * kTilePixels);
  }
  grid->bundles.resize(tiles);
  grid->center.resize(tiles * kDirectionSize);
  grid->cells_x = (grid->tiles_x + kCellSize - 1) / kCellSize;
  grid->cells_y = (grid->tiles_y + kCellSize - 1) / kCellSize;
  const std::size_t cells = static_cast<std::size_t>(grid->num_cells());
  grid->groups_x = (grid->tiles_x + kGroupStep - 1) / kGroupStep;
  grid->groups_y = (grid->tiles_y + kGroupStep - 1) / kGroupStep;
  grid->group_tiles.resize(static_cast<std::size_t>(grid->num_groups()) * RayBox::kSize *
                           kCellTiles);
  for (AlignedVector<float>& v : grid->cell_boxes) v.assign(cells + kCellPadding, 0.0f);
  grid->cell_wide.assign(cells + kCellPadding, 0.0f);
  grid->block_box.resize(tiles * 4 * static_cast<std::size_t>(grid->block_stride));
  grid->alive.assign(tiles, 0);
  const RayTable& rays = camera.Rays();
  std::vector<std::uint8_t> narrow(tiles, 1);
  ParallelFor(grid->num_tiles(), 16, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t tile = begin; tile < end; ++tile) {
      narrow[static_cast<std::size_t>(tile)] = FillTile(rays, static_cast<int>(tile), grid.get());
    }
  });
  ParallelFor(grid->num_groups(), 64, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t group = begin; group < end; ++group) {
      FillGroup(static_cast<int>(group), grid.get());
    }
  });
  ParallelFor(grid->num_cells(), 4, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t cell = begin; cell < end; ++cell) {
      FillCell(rays, static_cast<int>(cell), grid.get());
    }
  });
  grid->too_wide = std::find(narrow.begin(), narrow.end(), 0) != narrow.end();
  return grid;
}

struct CachedGrid {
  const RayTable* rays;
  std::weak_ptr<const RayTable> alive;  // guards against another table at the same address
  int lanes;
  std::shared_ptr<const TileGrid> grid;
};

}  // namespace

// A box of directions as centre and two half widths, d = centre + x half_s + y half_t with |x|, |y|
// <= 1: a linear form f has values within f.centre +- (|f.half_s| + |f.half_t|).
RayBox::RayBox(const RayBundle& bundle) {
  const auto axis = [&](int k) -> Vector3d {
    return Eigen::Map<const Eigen::Vector3f>(&bundle.values[RayBundle::kFrame + 3 * k])
        .cast<double>();
  };
  const float* v = bundle.values;
  const Vector3d center =
      axis(0) + v[RayBundle::kCenter] * axis(1) + v[RayBundle::kCenter + 1] * axis(2);
  // Of any length: not far above 1, what rounding takes stays within FormLanes' slack.
  const double scale = 1.0 / center.norm();
  const bool has_ray = v[RayBundle::kHasRay] != 0.0f;
  for (int k = 0; k < 3; ++k) {
    values[kCenter + k] =
        has_ray ? static_cast<float>(scale * center[k]) : std::numeric_limits<float>::quiet_NaN();
    values[kHalfS + k] = static_cast<float>(scale * v[RayBundle::kHalf] * axis(1)[k]);
    values[kHalfT + k] = static_cast<float>(scale * v[RayBundle::kHalf + 1] * axis(2)[k]);
  }
}

// Grids of the last cameras, most recent first, found by ray table and number of lanes.
std::shared_ptr<const TileGrid> TilesOf(const Camera& camera, int lanes) {
  static std::mutex mutex;
  static std::list<CachedGrid> cache;
  const std::shared_ptr<const RayTable> rays = camera.SharedRays();
  const std::lock_guard<std::mutex> lock(mutex);
  cache.remove_if([](const CachedGrid& entry) { return entry.alive.expired(); });
  for (auto entry = cache.begin(); entry != cache.end(); ++entry) {
    if (entry->rays == rays.get() && entry->lanes == lanes) {
      cache.splice(cache.begin(), cache, entry);
      return cache.front().grid;
    }
  }
  cache.push_front({rays.get(), rays, lanes, BuildTiles(camera, lanes)});
  if (cache.size() > kCacheSize) cache.pop_back();
  return cache.front().grid;
}

}  // namespace gsut
