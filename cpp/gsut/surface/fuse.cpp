// First which blocks the depths touch, then each block against all views.
#include "gsut/surface/fuse.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/base/interrupt.h"
#include "gsut/base/parallel.h"
#include "gsut/surface/fuse_kernel.h"

namespace gsut {
namespace {

using Eigen::Vector3d;
using Block = std::array<std::int32_t, 3>;

// Blocks seen lately, so that neighbouring pixels do not name them again.
constexpr std::size_t kRecent = 4096;
// Voxels from the centre, beyond which numbers of blocks would no longer be whole numbers.
constexpr double kFarthest = 1e9;
// A distant pixel covers more voxels than this at most, to each side.
constexpr double kMostVoxelsOfPixel = 12;
// Points that stand for a block: its corners and its middle.
constexpr int kCorners = 9;
// What they are filled up to: whole vectors of any instruction set.
constexpr int kCornerBatch = 16;

// A truncated signed distance field (Curless and Levoy, 1996): each voxel near a surface keeps the
// weighted mean, over the views, of its distance to the surface that the view sees, in voxels and
// cut off at the truncation. Space is hashed into blocks of 8 x 8 x 8 voxels, and only those that a
// surface passes are made:
//   1. BlocksOf lists, view by view, the blocks within the truncation of a depth;
//   2. the lists are merged, so that blocks have one order on any number of threads;
//   3. BlockFusion adds up all views, block by block.

// Numbers one by one: array's own operators compare bytes by a call.
bool Same(const Block& a, const Block& b) { return a[0] == b[0] && a[1] == b[1] && a[2] == b[2]; }
bool Before(const Block& a, const Block& b) {
  return a[0] != b[0] ? a[0] < b[0] : a[1] != b[1] ? a[1] < b[1] : a[2] < b[2];
}

void SortUnique(std::vector<Block>* blocks) {
  std::sort(blocks->begin(), blocks->end(), Before);
  blocks->erase(std::unique(blocks->begin(), blocks->end(), Same), blocks->end());
}

struct BlockCollector {
  std::size_t most = 0;  // of a view; when there are more, the rest is not looked for
  std::vector<Block> found;
  std::vector<Block> recent = std::vector<Block>(kRecent, Block{INT32_MIN, 0, 0});
  bool full = false;

  // Blocks with voxels within `margin` of a point in grid coordinates.
  void Add(const Vector3d& grid, double margin) {
    full = full || !(grid.cwiseAbs().maxCoeff() < kFarthest);
    if (full) return;
    Block low, high;
    for (int k = 0; k < 3; ++k) {
      const auto at = static_cast<std::size_t>(k);
      low[at] = static_cast<std::int32_t>(std::floor((grid[k] - margin) / kBlockSide));
      high[at] = static_cast<std::int32_t>(std::floor((grid[k] + margin) / kBlockSide));
    }
    for (std::int32_t z = low[2]; z <= high[2]; ++z) {
      for (std::int32_t y = low[1]; y <= high[1]; ++y) {
        for (std::int32_t x = low[0]; x <= high[0]; ++x) {
          const Block block = {x, y, z};
          const std::uint32_t hash = static_cast<std::uint32_t>(x) * 73856093u ^
                                     static_cast<std::uint32_t>(y) * 19349663u ^
                                     static_cast<std::uint32_t>(z) * 83492791u;
          Block& seen = recent[hash % kRecent];
          if (Same(seen, block)) continue;
          seen = block;
          found.push_back(block);
        }
      }
    }
    if (found.size() <= 2 * most) return;
    SortUnique(&found);
    full = found.size() > most;
  }
};

// In order, none twice; of more than `most`, some more than that.
// Which blocks a view's surface passes: three points a pixel, at its depth and half a truncation
// before and behind, each with the voxels around it that the pixel covers.
std::vector<Block> BlocksOf(const DepthView& view, const VoxelSpace& space, double truncation,
                            std::size_t most) {
  BlockCollector collector;
  collector.most = most;
  for (int y = 0; y < view.height() && !collector.full; ++y) {
    for (int x = 0; x < view.width(); ++x) {
      DepthSample sample;
      if (!view.At(x, y, &sample) || sample.depth > DepthSample::kFree) continue;
      const double depth = double{sample.depth};
      const Vector3d point = view.PointOf(x, y, depth);
      const Vector3d grid = space.GridOf(space.center + point);
      if (!space.Holds(grid)) continue;
      const double voxel = space.VoxelAt(grid);
      // A cell that the surface crosses has voxels within 1 of it; pixels lie this far apart there.
      const double apart = depth * view.pixel_angle() / (double{sample.cosine} * voxel);
      const double margin = 1.0 + std::min(apart, kMostVoxelsOfPixel);
      // At the surface and half a truncation before and behind it: the band has no gap.
      const Vector3d step = 0.5 * truncation * voxel * (point - view.place()).normalized();
      for (const double side : {-1.0, 0.0, 1.0}) {
        const Vector3d at = space.GridOf(space.center + point + side * step);
        if (space.Holds(at)) collector.Add(at, margin);
      }
    }
  }
  SortUnique(&collector.found);
  if (collector.full) collector.found.resize(most + 1);
  return std::move(collector.found);
}

// One block's voxels about the centre, its corners, and what the views add up to.
class BlockFusion {
 public:
  BlockFusion(const VoxelSpace& space, const FuseOptions& options, const Block& block)
      : space_(space),
        truncation_(static_cast<float>(options.truncation)),
        free_weight_(static_cast<float>(options.free_weight)) {
    Place(block);
    std::fill(std::begin(sum_), std::end(sum_), 0.0f);
    std::fill(std::begin(weight_), std::end(weight_), 0.0f);
  }

  // Adds one view: a cheap test of the whole block first, then all its voxels through the lens.
  void Add(const DepthView& view, ViewedBatch* viewed) {
    if (!MaySee(view, viewed)) return;
    view.Project(kBlockVoxels, voxels_, viewed);
    AddDepths(view.pixels(), truncation_, free_weight_, kBlockVoxels,
              {viewed->u, viewed->v, viewed->distance, size_, sum_, weight_});
  }

  void Write(float* values) const {
    for (int i = 0; i < kBlockVoxels; ++i) {
      values[i] =
          weight_[i] > 0.0f ? sum_[i] / weight_[i] : std::numeric_limits<float>::quiet_NaN();
    }
  }

 private:
  // Voxels outside the space keep size 0, which no view adds to.
  void Place(const Block& block) {
    const Vector3d first(block[0], block[1], block[2]);
    int i = 0;
    for (int z = 0; z < kBlockSide; ++z) {
      for (int y = 0; y < kBlockSide; ++y) {
        for (int x = 0; x < kBlockSide; ++x, ++i) {
          const Vector3d grid = kBlockSide * first + Vector3d(x, y, z);
          const bool inside = space_.Holds(grid);
          Set(&voxels_, i, inside ? space_.AboutCenter(grid) : Vector3d::Zero());
          size_[i] = inside ? static_cast<float>(space_.VoxelAt(grid)) : 0.0f;
        }
      }
    }
    for (int corner = 0; corner < kCornerBatch; ++corner) {
      const int side = kBlockSide - 1;
      const int of = corner < 8 ? (corner & 1) * side + (corner >> 1 & 1) * side * kBlockSide +
                                      (corner >> 2 & 1) * side * kBlockSide * kBlockSide
                                : kBlockVoxels / 2 + kBlockSide * kBlockSide / 2 + kBlockSide / 2;
      Set(&corners_, corner, Vector3d(voxels_.x[of], voxels_.y[of], voxels_.z[of]));
    }
    middle_ = Vector3d(corners_.x[8], corners_.y[8], corners_.z[8]);
    radius_ = 0.0;
    for (int k = 0; k < 8; ++k) {
      radius_ = std::max(radius_,
                         (Vector3d(corners_.x[k], corners_.y[k], corners_.z[k]) - middle_).norm());
    }
    const float* largest = std::max_element(std::begin(size_), std::end(size_));
    reach_ = *largest * truncation_;
  }

  static void Set(PointBatch* batch, int i, const Vector3d& point) {
    batch->x[i] = static_cast<float>(point[0]);
    batch->y[i] = static_cast<float>(point[1]);
    batch->z[i] = static_cast<float>(point[2]);
  }

  // False where no voxel lies in the image, or all lie well behind what the view sees there.
  bool MaySee(const DepthView& view, ViewedBatch* viewed) const {
    // Close by, corners say little about what lies between them.
    if ((view.place() - middle_).norm() < 2.0 * radius_) return true;
    view.Project(kCornerBatch, corners_, viewed);
    const float width = static_cast<float>(view.width());
    const float height = static_cast<float>(view.height());
    float low[2] = {width, height}, high[2] = {0.0f, 0.0f};
    for (int i = 0; i < kCorners; ++i) {
      const float u = viewed->u[i], v = viewed->v[i];
      if (!(std::isfinite(u) && std::isfinite(v))) continue;
      low[0] = std::min(low[0], u), low[1] = std::min(low[1], v);
      high[0] = std::max(high[0], u), high[1] = std::max(high[1], v);
    }
    const bool in_image = low[0] < width && low[1] < height && high[0] > 0.0f && high[1] > 0.0f;
    return in_image && !AllBehind(view.pixels(), kCornerBatch, viewed->u, viewed->v,
                                  viewed->distance, 2.0f * kSlant * reach_);
  }

  const VoxelSpace& space_;
  const float truncation_, free_weight_;
  PointBatch voxels_, corners_;
  alignas(64) float size_[kBlockVoxels];
  alignas(64) float sum_[kBlockVoxels];
  alignas(64) float weight_[kBlockVoxels];
  Vector3d middle_;
  double radius_ = 0;
  float reach_ = 0;
};

}  // namespace

std::int64_t DistanceField::Find(const Block& block) const {
  const auto at = std::lower_bound(blocks.begin(), blocks.end(), block);
  return at != blocks.end() && *at == block ? at - blocks.begin() : -1;
}

// With `max_blocks` the memory is known before it is taken: views stop early where one alone has
// more, and merging stops at the first excess.
DistanceField FuseDepth(const std::vector<DepthView>& views, const VoxelSpace& space,
                        const FuseOptions& options) {
  DistanceField field;
  field.space = space;
  std::vector<std::vector<Block>> of_views(views.size());
  const std::size_t most = options.max_blocks > 0 ? static_cast<std::size_t>(options.max_blocks)
                                                  : std::numeric_limits<std::size_t>::max() / 2;
  std::atomic<bool> too_many = false;
  ParallelFor(static_cast<std::int64_t>(views.size()), 1, [&](std::int64_t i, std::int64_t) {
    if (too_many) return;
    const auto at = static_cast<std::size_t>(i);
    of_views[at] = BlocksOf(views[at], space, options.truncation, most);
    if (of_views[at].size() > most) too_many = true;
  });
  const auto check = [&] {
    if (!too_many && field.blocks.size() <= most) return;
    throw InputError("the surface fills more than the " + std::to_string(most) +
                     " blocks of 8 x 8 x 8 voxels that memory is allowed for; take larger voxels");
  };
  check();
  // Sorted lists merge into one sorted list; each is freed as it is taken in.
  for (std::vector<Block>& of_view : of_views) {
    const auto before = static_cast<std::ptrdiff_t>(field.blocks.size());
    field.blocks.insert(field.blocks.end(), of_view.begin(), of_view.end());
    std::inplace_merge(field.blocks.begin(), field.blocks.begin() + before, field.blocks.end(),
                       Before);
    field.blocks.erase(std::unique(field.blocks.begin(), field.blocks.end(), Same),
                       field.blocks.end());
    of_view = {};
    check();
    CheckInterrupt();
  }
  const auto count = static_cast<std::int64_t>(field.blocks.size());
  field.values.resize(static_cast<std::size_t>(count) * kBlockVoxels);
  // Neighbouring blocks look at the same pixels of a view, which are then still in the cache.
  constexpr std::int64_t kGrain = 16;
  ParallelFor(count, kGrain, [&](std::int64_t begin, std::int64_t end) {
    std::vector<BlockFusion> fusions;
    fusions.reserve(static_cast<std::size_t>(end - begin));
    for (std::int64_t i = begin; i < end; ++i) {
      fusions.emplace_back(field.space, options, field.blocks[static_cast<std::size_t>(i)]);
    }
    ViewedBatch viewed;
    for (const DepthView& view : views) {
      for (BlockFusion& fusion : fusions) fusion.Add(view, &viewed);
    }
    float* values = &field.values[static_cast<std::size_t>(begin) * kBlockVoxels];
    for (const BlockFusion& fusion : fusions) {
      fusion.Write(values);
      values += kBlockVoxels;
    }
  });
  return field;
}

}  // namespace gsut
