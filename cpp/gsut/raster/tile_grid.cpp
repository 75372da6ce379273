// Builds the tiles of a camera from its ray table, in double.
#include "gsut/raster/tile_grid.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <list>
#include <mutex>

#include "gsut/base/parallel.h"

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

// Fills one tile; returns false if its rays spread too wide.
bool FillTile(const RayTable& rays, int tile, TileGrid* grid) {
  const int x0 = (tile % grid->tiles_x) * kTileSize;
  const int y0 = (tile / grid->tiles_x) * kTileSize;
  const int x1 = std::min(x0 + kTileSize, grid->width);
  const int y1 = std::min(y0 + kTileSize, grid->height);
  const auto valid = [&](int x, int y) {
    return rays.valid[static_cast<std::size_t>(y) * grid->width + x] != 0;
  };
  const auto ray = [&](int x, int y) -> Vector3d {
    return Eigen::Map<const Vector3d>(
        &rays.rays[3 * (static_cast<std::size_t>(y) * grid->width + x)]);
  };
  Vector3d axis = Vector3d::Zero();
  Vector3d along = Vector3d::Zero();  // mean change of the ray per pixel to the right
  for (int y = y0; y < y1; ++y) {
    for (int x = x0; x < x1; ++x) {
      if (!valid(x, y)) continue;
      axis += ray(x, y);
      if (x + 1 < x1 && valid(x + 1, y)) along += ray(x + 1, y) - ray(x, y);
    }
  }
  const bool any = axis.squaredNorm() > 0;
  axis = any ? axis.normalized() : Vector3d::UnitZ();
  Vector3d e1 = along - axis * axis.dot(along);
  if (!(e1.norm() > 1e-9)) e1 = axis.unitOrthogonal();
  e1.normalize();
  const Vector3d e2 = axis.cross(e1);
  for (int k = 0; k < 3; ++k) {
    grid->frame[k][tile] = static_cast<float>(axis[k]);
    grid->frame[3 + k][tile] = static_cast<float>(e1[k]);
    grid->frame[6 + k][tile] = static_cast<float>(e2[k]);
  }
  Box tile_box;
  std::vector<Box> block_boxes(static_cast<std::size_t>(grid->blocks));
  bool narrow = true;
  std::uint64_t alive = 0;
  for (int row = 0; row < kTileSize; ++row) {
    for (int column = 0; column < kTileSize; ++column) {
      const int offset = grid->PixelOffset(column, row);
      const std::size_t i = static_cast<std::size_t>(tile) * kTilePixels + offset;
      const int x = x0 + column;
      const int y = y0 + row;
      grid->s[i] = grid->t[i] = grid->start[i] = 0.0f;
      grid->length[i] = 1.0f;
      if (x >= x1 || y >= y1 || !valid(x, y)) continue;
      const Vector3d d = ray(x, y);
      const double cosine = d.dot(axis);
      if (!(cosine > kMinCosine)) {
        narrow = false;
        continue;
      }
      const double s = d.dot(e1) / cosine;
      const double t = d.dot(e2) / cosine;
      grid->s[i] = static_cast<float>(s);
      grid->t[i] = static_cast<float>(t);
      grid->length[i] = static_cast<float>(std::sqrt(1.0 + s * s + t * t));
      grid->start[i] = 1.0f;
      const int block = offset / grid->lanes;
      alive |= std::uint64_t{1} << block;
      tile_box.Add(s, t);
      block_boxes[static_cast<std::size_t>(block)].Add(s, t);
    }
  }
  grid->alive[tile] = alive;
  grid->has_ray[tile] = alive != 0 ? 1.0f : 0.0f;
  tile_box.Store(&grid->box[0][tile], &grid->box[1][tile], &grid->box[2][tile],
                 &grid->box[3][tile]);
  float* boxes = &grid->block_box[static_cast<std::size_t>(tile) * 4 * grid->block_stride];
  std::fill_n(boxes, 4 * grid->block_stride, 0.0f);
  for (int b = 0; b < grid->blocks; ++b) {
    block_boxes[static_cast<std::size_t>(b)].Store(
        &boxes[b], &boxes[grid->block_stride + b], &boxes[2 * grid->block_stride + b],
        &boxes[3 * grid->block_stride + b]);
  }
  return narrow;
}

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
  for (AlignedVector<float>& v : grid->frame) v.assign(tiles + kTilePadding, 0.0f);
  for (AlignedVector<float>& v : grid->box) v.assign(tiles + kTilePadding, 0.0f);
  grid->has_ray.assign(tiles + kTilePadding, 0.0f);
  grid->block_box.resize(tiles * 4 * static_cast<std::size_t>(grid->block_stride));
  grid->alive.assign(tiles, 0);
  const RayTable& rays = camera.Rays();
  std::vector<std::uint8_t> narrow(tiles, 1);
  ParallelFor(grid->num_tiles(), 16, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t tile = begin; tile < end; ++tile) {
      narrow[static_cast<std::size_t>(tile)] = FillTile(rays, static_cast<int>(tile), grid.get());
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
