// Builds the tiles and bounds of lines, in double; keeps those of the last views.
#include "gsut/raster/line_grid.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <list>
#include <mutex>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;

// As in tile_grid.cpp: the smallest cosine between a ray and the axis of its bundle.
constexpr double kMinCosine = 0.1;
// Ranges are widened by this factor, and by a few ulp of their ends, so that rounding to float
// never shrinks them.
constexpr double kRangeMargin = 1.0001;
constexpr double kFloatEps = 1.2e-7;
// Grids kept, in bytes: views of a data set are rendered again and again.
constexpr std::int64_t kCacheBytes = std::int64_t{512} << 20;

struct Frame3 {
  Vector3d d, e1, e2;
};

// A line is a E1 + b E2 + x (D + s E1 + t E2): from origin o and direction r, s = r.E1 / r.D and
// t = r.E2 / r.D; the origin is slid along the line to where x = 0: a = o.E1 - (o.D) s, b alike.
// The slide o.D remains, as nothing before the origin may be drawn. a, b, s, t and slide of a ray
// in a frame; false if it runs across the axis.
bool PlaceLine(const Frame3& frame, const Vector3d& origin, const Vector3d& ray, double* line) {
  const double cosine = ray.dot(frame.d);
  if (!(cosine > kMinCosine)) return false;
  const double slide = origin.dot(frame.d);
  line[2] = ray.dot(frame.e1) / cosine;
  line[3] = ray.dot(frame.e2) / cosine;
  line[0] = origin.dot(frame.e1) - slide * line[2];
  line[1] = origin.dot(frame.e2) - slide * line[3];
  line[4] = slide;
  return true;
}

struct Ranges {
  // Of a, b, s, t and slide.
  double low[5], high[5];
  Ranges() {
    std::fill_n(low, 5, 1e300);
    std::fill_n(high, 5, -1e300);
  }
  bool empty() const { return low[0] > high[0]; }
  void Add(const double* line) {
    for (int k = 0; k < 5; ++k) {
      low[k] = std::min(low[k], line[k]);
      high[k] = std::max(high[k], line[k]);
    }
  }
  // Centre and half width of a, b, s or t, rounded outwards.
  void Store(int k, float* center, float* half) const {
    *center = *half = 0.0f;
    if (empty()) return;
    *center = static_cast<float>(0.5 * (low[k] + high[k]));
    *half = static_cast<float>(0.5 * (high[k] - low[k]) * kRangeMargin +
                               kFloatEps * (std::abs(low[k]) + std::abs(high[k])));
  }
};

// The rays of a rectangle of pixels.
class PixelLines {
 public:
  PixelLines(const ViewRays& view, int x0, int y0, int size)
      : view_(view),
        x0_(x0),
        y0_(y0),
        x1_(std::min(x0 + size, view.width)),
        y1_(std::min(y0 + size, view.height)) {}

  // visit(x, y, origin, ray) for each pixel that has one.
  template <class Visit>
  void ForEach(Visit&& visit) const {
    for (int y = y0_; y < y1_; ++y) {
      for (int x = x0_; x < x1_; ++x) {
        const std::size_t i = static_cast<std::size_t>(y) * view_.width + x;
        if (!view_.valid[i]) continue;
        const Vector3d origin = view_.HasOrigins()
                                    ? Vector3d(Map<const Vector3d>(&view_.origins[3 * i]))
                                    : Vector3d(Vector3d::Zero());
        visit(x, y, origin, Vector3d(Map<const Vector3d>(&view_.rays[3 * i])));
      }
    }
  }

  // D: mean direction; E1: where rays, or their origins, go to the right; E2 = D x E1.
  Frame3 MeanFrame() const {
    Vector3d axis = Vector3d::Zero();
    Vector3d along = Vector3d::Zero();
    ForEach([&](int x, int y, const Vector3d&, const Vector3d& ray) {
      axis += ray;
      const std::size_t next = static_cast<std::size_t>(y) * view_.width + x + 1;
      if (x + 1 < x1_ && view_.valid[next]) {
        along += Map<const Vector3d>(&view_.rays[3 * next]) - ray;
      }
    });
    Frame3 frame;
    frame.d = axis.squaredNorm() > 0 ? axis.normalized() : Vector3d(Vector3d::UnitZ());
    frame.e1 = along - frame.d * frame.d.dot(along);
    if (!(frame.e1.norm() > 1e-9)) frame.e1 = frame.d.unitOrthogonal();
    frame.e1.normalize();
    frame.e2 = frame.d.cross(frame.e1);
    return frame;
  }

 private:
  const ViewRays& view_;
  int x0_, y0_, x1_, y1_;
};

LineBundle MakeBundle(const Frame3& frame, const Ranges& ranges, bool wide) {
  LineBundle bundle;
  float* v = bundle.values;
  for (int k = 0; k < 3; ++k) {
    v[LineBundle::kD + k] = static_cast<float>(frame.d[k]);
    v[LineBundle::kD + 3 + k] = static_cast<float>(frame.e1[k]);
    v[LineBundle::kD + 6 + k] = static_cast<float>(frame.e2[k]);
  }
  for (int k = 0; k < 4; ++k) {
    ranges.Store(k, &v[LineBundle::kCenter + k], &v[LineBundle::kHalf + k]);
  }
  if (!ranges.empty()) {
    v[LineBundle::kSlide] =
        static_cast<float>(ranges.low[4] - 2.0 * kFloatEps * std::abs(ranges.low[4]));
  }
  v[LineBundle::kState] = wide             ? LineBundle::kWide
                          : ranges.empty() ? LineBundle::kEmpty
                                           : LineBundle::kNarrow;
  return bundle;
}

// A bundle of the pixels in a square.
LineBundle BundleOf(const ViewRays& view, int x0, int y0, int size) {
  const PixelLines pixels(view, x0, y0, size);
  const Frame3 frame = pixels.MeanFrame();
  Ranges ranges;
  bool wide = false;
  pixels.ForEach([&](int, int, const Vector3d& origin, const Vector3d& ray) {
    double line[5];
    if (PlaceLine(frame, origin, ray, line)) {
      ranges.Add(line);
    } else {
      wide = true;
    }
  });
  return MakeBundle(frame, ranges, wide);
}

// The numbers of each line of a tile, and their ranges over the tile and over each of its blocks. A
// pixel without a ray starts with no transmittance: the kernels blend nothing there and need no
// mask.
void FillTile(const ViewRays& view, int tile, LineGrid* grid) {
  TileGrid& tiles = grid->tiles;
  const int x0 = (tile % tiles.tiles_x) * kTileSize;
  const int y0 = (tile / tiles.tiles_x) * kTileSize;
  const PixelLines pixels(view, x0, y0, kTileSize);
  const Frame3 frame = pixels.MeanFrame();
  const std::size_t first = static_cast<std::size_t>(tile) * kTilePixels;
  for (AlignedVector<float>* v :
       {&tiles.s, &tiles.t, &tiles.start, &grid->a, &grid->b, &grid->slide}) {
    std::fill_n(&(*v)[first], kTilePixels, 0.0f);
  }
  std::fill_n(&tiles.length[first], kTilePixels, 1.0f);
  Ranges of_tile;
  std::vector<Ranges> of_blocks(static_cast<std::size_t>(tiles.blocks));
  bool wide = false;
  std::uint64_t alive = 0;
  pixels.ForEach([&](int x, int y, const Vector3d& origin, const Vector3d& ray) {
    double line[5];
    if (!PlaceLine(frame, origin, ray, line)) {
      wide = true;
      return;
    }
    const int offset = tiles.PixelOffset(x - x0, y - y0);
    const std::size_t i = first + static_cast<std::size_t>(offset);
    grid->a[i] = static_cast<float>(line[0]);
    grid->b[i] = static_cast<float>(line[1]);
    tiles.s[i] = static_cast<float>(line[2]);
    tiles.t[i] = static_cast<float>(line[3]);
    grid->slide[i] = static_cast<float>(line[4]);
    tiles.length[i] = static_cast<float>(std::sqrt(1.0 + line[2] * line[2] + line[3] * line[3]));
    tiles.start[i] = 1.0f;
    const int block = offset / tiles.lanes;
    alive |= std::uint64_t{1} << block;
    of_tile.Add(line);
    of_blocks[static_cast<std::size_t>(block)].Add(line);
  });
  tiles.alive[static_cast<std::size_t>(tile)] = alive;
  grid->bundles[static_cast<std::size_t>(tile)] = MakeBundle(frame, of_tile, wide);
  float* boxes = &grid->block_box[static_cast<std::size_t>(tile) * 8 * tiles.block_stride];
  std::fill_n(boxes, 8 * tiles.block_stride, 0.0f);
  for (int block = 0; block < tiles.blocks; ++block) {
    for (int k = 0; k < 4; ++k) {
      of_blocks[static_cast<std::size_t>(block)].Store(
          k, &boxes[k * tiles.block_stride + block], &boxes[(4 + k) * tiles.block_stride + block]);
    }
  }
}

// Groups 4 x 4 nodes, a column of 16 floats a value: one vector tests a whole group.
LineLevel MakeLevel(const std::vector<LineBundle>& nodes, int nodes_x, int nodes_y) {
  LineLevel level;
  level.nodes_x = nodes_x;
  level.nodes_y = nodes_y;
  level.groups_x = (nodes_x + 3) / 4;
  level.groups_y = (nodes_y + 3) / 4;
  level.groups.assign(static_cast<std::size_t>(level.groups_x) * level.groups_y *
                          LineBundle::kSize * LineLevel::kGroup,
                      0.0f);
  for (int y = 0; y < nodes_y; ++y) {
    for (int x = 0; x < nodes_x; ++x) {
      const LineBundle& node = nodes[static_cast<std::size_t>(y) * nodes_x + x];
      float* group = const_cast<float*>(level.Group(x / 4, y / 4));
      for (int k = 0; k < LineBundle::kSize; ++k) {
        group[k * LineLevel::kGroup + (y % 4) * 4 + x % 4] = node.values[k];
      }
    }
  }
  return level;
}

bool SamePose(const Pose& a, const Pose& b) {
  return a.rotation == b.rotation && a.translation == b.translation;
}

// The lines depend on how the camera moves only, not on where in the world it is; poses that are
// the same from one call to the next are the usual case of the same motion.
struct CachedLines {
  const RayTable* rays;
  std::weak_ptr<const RayTable> alive;  // guards against another table at the same address
  CameraMotion motion;
  int lanes;
  std::shared_ptr<const LineGrid> grid;

  bool Fits(const RayTable* table, const CameraMotion& other, int other_lanes) const {
    const Shutter &a = motion.shutter, &b = other.shutter;
    return rays == table && lanes == other_lanes && a.direction == b.direction &&
           a.gsplat_parity == b.gsplat_parity &&
           (a.IsGlobal() ||
            (SamePose(motion.start, other.start) && SamePose(motion.end, other.end)));
  }
};

struct LineCache {
  std::mutex mutex;
  std::list<CachedLines> entries;
};

LineCache& Cache() {
  static LineCache cache;
  return cache;
}

}  // namespace

std::int64_t LineGrid::bytes() const {
  std::size_t floats = a.size() + b.size() + slide.size() + block_box.size() + tiles.s.size() +
                       tiles.t.size() + tiles.start.size() + tiles.length.size() +
                       bundles.size() * LineBundle::kSize;
  for (const LineLevel& level : levels) floats += level.groups.size();
  return static_cast<std::int64_t>(floats * sizeof(float));
}

// Level 0 of the pyramid is the tiles' own bundles; a node of each further level bundles 4 x 4
// nodes of the one before. It is made from the rays, not from the bounds below it, in a frame of
// its own, so that its bounds are as tight as such bounds can be. Levels end at one group of 4 x 4.
std::shared_ptr<const LineGrid> MakeLineGrid(const ViewRays& view, int lanes) {
  auto grid = std::make_shared<LineGrid>();
  grid->is_parallel = view.is_parallel;
  TileGrid& tiles = grid->tiles;
  tiles.width = view.width;
  tiles.height = view.height;
  tiles.tiles_x = (view.width + kTileSize - 1) / kTileSize;
  tiles.tiles_y = (view.height + kTileSize - 1) / kTileSize;
  tiles.lanes = lanes;
  tiles.blocks = kTilePixels / lanes;
  tiles.block_stride = (tiles.blocks + lanes - 1) / lanes * lanes;
  const std::size_t count = static_cast<std::size_t>(tiles.num_tiles());
  for (AlignedVector<float>* v :
       {&tiles.s, &tiles.t, &tiles.start, &tiles.length, &grid->a, &grid->b, &grid->slide}) {
    v->resize(count * kTilePixels);
  }
  tiles.alive.assign(count, 0);
  grid->bundles.resize(count);
  grid->block_box.resize(count * 8 * static_cast<std::size_t>(tiles.block_stride));
  ParallelFor(tiles.num_tiles(), 8, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t tile = begin; tile < end; ++tile) {
      FillTile(view, static_cast<int>(tile), grid.get());
    }
  });
  for (const LineBundle& bundle : grid->bundles) {
    grid->tiles.too_wide =
        grid->tiles.too_wide || bundle.values[LineBundle::kState] == LineBundle::kWide;
  }
  int nodes_x = tiles.tiles_x, nodes_y = tiles.tiles_y, size = kTileSize;
  grid->levels.push_back(MakeLevel(grid->bundles, nodes_x, nodes_y));
  while (nodes_x > 4 || nodes_y > 4) {
    nodes_x = (nodes_x + 3) / 4;
    nodes_y = (nodes_y + 3) / 4;
    size *= 4;
    std::vector<LineBundle> nodes(static_cast<std::size_t>(nodes_x) * nodes_y);
    ParallelFor(static_cast<std::int64_t>(nodes.size()), 1, [&](std::int64_t i, std::int64_t) {
      const int x = static_cast<int>(i) % nodes_x, y = static_cast<int>(i) / nodes_x;
      nodes[static_cast<std::size_t>(i)] = BundleOf(view, x * size, y * size, size);
    });
    grid->levels.push_back(MakeLevel(nodes, nodes_x, nodes_y));
  }
  return grid;
}

// The grids used last, most recent first; the oldest leave where all together exceed kCacheBytes.
std::shared_ptr<const LineGrid> LinesOf(const Camera& camera, const CameraMotion& motion,
                                        int lanes) {
  const std::shared_ptr<const RayTable> rays = camera.SharedRays();
  LineCache& cache = Cache();
  const std::lock_guard<std::mutex> lock(cache.mutex);
  std::list<CachedLines>& entries = cache.entries;
  entries.remove_if([](const CachedLines& entry) { return entry.alive.expired(); });
  for (auto entry = entries.begin(); entry != entries.end(); ++entry) {
    if (entry->Fits(rays.get(), motion, lanes)) {
      entries.splice(entries.begin(), entries, entry);
      return entries.front().grid;
    }
  }
  entries.push_front(
      {rays.get(), rays, motion, lanes, MakeLineGrid(MakeViewRays(camera, motion), lanes)});
  std::int64_t bytes = 0;
  auto entry = entries.begin();
  for (; entry != entries.end(); ++entry) {
    bytes += entry->grid->bytes();
    if (bytes > kCacheBytes && entry != entries.begin()) break;
  }
  entries.erase(entry, entries.end());
  return entries.front().grid;
}

}  // namespace gsut
