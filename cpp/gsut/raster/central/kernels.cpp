// The kernels of Gaussians along rays from one point, compiled once per instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/raster/central/kernels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <cmath>
#include <memory>
#include <type_traits>
#include <vector>

#include "gsut/gaussians/harmonics.h"
#include "gsut/raster/central/kernels.h"
#include "gsut/raster/sharp_records.h"

#include "gsut/raster/central/records-inl.h"
#include "gsut/raster/central/gradients-inl.h"
#include "gsut/raster/central/forward-inl.h"
#include "gsut/raster/central/backward-inl.h"
#include "gsut/raster/harmonics-inl.h"
#include "gsut/raster/pixels-inl.h"
#include "gsut/raster/tile_rect-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// The direction n of a mean, see sharp_records.h.
// In double, and split into two floats: rounding the direction to one float would move a sharp
// Gaussian by more than its width.
void ExactDirection(const ViewFloats& view, const float* mean, float* out) {
  double world[3], n[3];
  for (int k = 0; k < 3; ++k) {
    world[k] = static_cast<double>(mean[k]) - static_cast<double>(view.center_high[k]) -
               static_cast<double>(view.center_low[k]);
  }
  for (int k = 0; k < 3; ++k) {
    n[k] = 0.0;
    for (int j = 0; j < 3; ++j) {
      n[k] += (static_cast<double>(view.rotation[3 * k + j]) +
               static_cast<double>(view.rotation_low[3 * k + j])) *
              world[j];
    }
  }
  const double inverse = 1.0 / std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
  for (double& component : n) component *= inverse;
  SplitDirection(n, out);
}

// Pixels of the Gaussians [first, first + kLanes) where an ellipse bounds their footprint or
// guesses it.
EllipseTiles TilesOfEllipses(const TileGrid& grid, const Splats& splats, std::size_t first) {
  const FloatTag d;
  constexpr float kRounding = 0.01f;  // pixels: of float coordinates up to 65 536
  const auto load = [&](const AlignedVector<float>& values)
                        HWY_ATTR { return Lane(hn::LoadU(d, &values[first])); };
  HWY_ALIGN float small[kLanes];
  for (int k = 0; k < kLanes; ++k) {
    const SplatStatus status = splats.status[first + static_cast<std::size_t>(k)];
    small[k] = status == SplatStatus::kSmall ? 1.0f : 0.0f;
  }
  const Lane extent_u = load(splats.extent_u), extent_v = load(splats.extent_v);
  const Lane bend = Lane(kSmallMargin) * load(splats.sine) * Max(extent_u, extent_v);
  const LaneMask is_small = Lane(hn::Load(d, small)) > Lane(0.0);
  const Lane widen = Lane(kRounding) + Select(is_small, bend, Lane(0.0));
  return {grid, load(splats.u), load(splats.v), extent_u + widen, extent_v + widen};
}

// Three degrees of trust in the ellipse: it bounds a small Gaussian; it is a guess, to be grown,
// for others; and where it says nothing all cells of the image are tested.
TileRect TilesOfSplat(const TileGrid& grid, SplatStatus status, const TileWindow& window,
                      const float* row, const FormSlack& slacks, int lane, TouchedRows* rows,
                      std::vector<RowSpan>* spans) {
  const FormLanes forms(row, slacks, lane);
  if (status == SplatStatus::kUncertain) return ExactTileRect(grid, forms, rows, spans);
  if (status == SplatStatus::kSmall) return BoundedTileRect(grid, forms, window, rows, spans);
  return GrownTileRect(grid, forms, window, rows, spans);
}

// Records of rays from one point, a Gaussian a lane: 1. vectors of which none is seen are skipped;
// 2. placed into the camera's frame, the three linear forms (records-inl.h); 3. colour in the
// direction from the camera; 4. one Gaussian at a time, its tiles.
void Records(const RasterTask& task, const TileGrid& grid, const Splats& splats, std::int64_t begin,
             std::int64_t end, Frame* frame) {
  const FloatTag d;
  const auto rows = std::make_unique_for_overwrite<TouchedRows>();
  std::vector<RowSpan>* spans = &frame->row_spans[static_cast<std::size_t>(begin / kRecordsPart)];
  for (std::int64_t i = begin; i < end; i += kLanes) {
    const int count = static_cast<int>(HWY_MIN(end - i, static_cast<std::int64_t>(kLanes)));
    bool any = false;
    for (int k = 0; k < count; ++k) {
      any = any || splats.status[static_cast<std::size_t>(i + k)] != SplatStatus::kUnseen;
    }
    for (int k = 0; k < count; ++k) frame->rects[static_cast<std::size_t>(i + k)] = {};
    if (!any) continue;
    const NextHarmonics next(task.gaussians, i);
    const SeenLanes g = LoadSeen(task.gaussians, i, task.view, task.log2_raw_min, task.max_cutoff);
    const RecordLanes r = MakeRecord(g);
    Lane direction[3], color[3];
    const Lane inverse_distance = Lane(1.0) / g.distance;
    for (int k = 0; k < 3; ++k) direction[k] = g.world[k] * inverse_distance;
    ColorOf(task.gaussians, task.sh_degree, i, direction, color);
    const LaneMask in_range =
        AndMask(g.mean[2] >= Lane(task.near_z), g.mean[2] <= Lane(task.far_z));
    const LaneMask finite_color = IsFinite(color[0] + color[1] + color[2]);
    const std::uint64_t visible = MaskBits(AndMask(AndMask(r.visible, in_range), finite_color).m);
    // Forms that are steep across the view lose digits to float directions: the sharp path has
    // more.
    const Lane steepest = Max(Dot3(r.a, r.a), Dot3(r.b, r.b));
    const LaneMask is_sharp = steepest > Lane(double{kSharpForm} * kSharpForm);
    const std::uint64_t sharp = MaskBits(is_sharp.m);
    const Lane red = Max(color[0], Lane(0.0)), green = Max(color[1], Lane(0.0)),
               blue = Max(color[2], Lane(0.0)), depth = Select(is_sharp, -g.distance, g.distance);
    const Lane columns[record::kSize] = {r.a[0], r.a[1], r.a[2], r.b[0], r.b[1],  r.b[2],
                                         r.c[0], r.c[1], r.c[2], r.k,    r.kappa, g.log2_strength,
                                         red,    green,  blue,   depth};
    const std::size_t first = static_cast<std::size_t>(i);
    StoreColumns(columns, record::kSize, count, &frame->records[first * record::kSize]);
    hn::StoreU((task.order_by_z ? g.mean[2] : g.distance).v, d, &frame->order_key[first]);
    const EllipseTiles windows = TilesOfEllipses(grid, splats, first);
    const FormSlack slacks(r.a, r.b, r.c);
    for (int k = 0; k < count; ++k) {
      if (k < next.count) next.Fetch<false>(task.gaussians.sh, k, next.stride);
      const std::size_t j = first + static_cast<std::size_t>(k);
      const SplatStatus status = splats.status[j];
      if (!((visible >> k) & 1) || status == SplatStatus::kUnseen) continue;
      if ((sharp >> k) & 1) {
        ExactDirection(task.view, task.gaussians.means + 3 * j,
                       &frame->mean_direction[j * kDirectionSize]);
      }
      frame->rects[j] = TilesOfSplat(grid, status, windows[k], &frame->records[j * record::kSize],
                                     slacks, k, rows.get(), spans);
    }
  }
}

void Forward(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame, float* image,
             float* alpha, float* depth, float* distortion) {
  WithFlag(task.with_depth, [&](auto with_depth) HWY_ATTR {
    CentralChunk chunk(grid, tile, *frame);
    BlendTile(with_depth, task, grid, tile, chunk, frame);
  });
  WritePixels(grid, tile, *frame, task.background, task.with_depth, image, alpha, depth,
              distortion);
}

void Backward(const RasterTask& task, const TileGrid& grid, int tile,
              const ImageGradients& gradients, Frame* frame, float* to_rays) {
  HWY_ALIGN float buffer[7 * kTilePixels];
  const PixelGradients pixels = ReadPixelGradients(grid, tile, gradients, task.background, buffer);
  // A build of the pass for each of these flags: only inlined, they are constants.
  const auto run = [&](BackwardFlags flags) GSUT_INLINED_LAMBDA {
    BackwardTile(flags, task, grid, tile, pixels, frame, to_rays);
  };
  const bool with_rays = to_rays != nullptr;
  if (gradients.error != nullptr) {  // comes alone, see Renderer::Backward
    run({false, false, true});
  } else if (gradients.HasDepth()) {
    run({true, with_rays, false});  // rays are rare here: a flag of the run
  } else {
    WithFlag(with_rays, [&](auto rays) HWY_ATTR { run({false, rays, false}); });
  }
}

void Gradients(const RasterTask& task, const Frame& frame, std::int64_t begin, std::int64_t end,
               const GradientRows& to, double* dpose) {
  for (std::int64_t i = begin; i < end; i += kLanes) {
    GaussianGradients(task, i, frame, to, dpose);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(Records);
HWY_EXPORT(Forward);
HWY_EXPORT(Backward);
HWY_EXPORT(Gradients);

void RecordsKernel(const RasterTask& task, const TileGrid& grid, const Splats& splats,
                   std::int64_t begin, std::int64_t end, Frame* frame) {
  HWY_DYNAMIC_DISPATCH(Records)(task, grid, splats, begin, end, frame);
}

void ForwardKernel(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame,
                   float* image, float* alpha, float* depth, float* distortion) {
  HWY_DYNAMIC_DISPATCH(Forward)(task, grid, tile, frame, image, alpha, depth, distortion);
}

void BackwardKernel(const RasterTask& task, const TileGrid& grid, int tile,
                    const ImageGradients& gradients, Frame* frame, float* to_rays) {
  HWY_DYNAMIC_DISPATCH(Backward)(task, grid, tile, gradients, frame, to_rays);
}

void GradientsKernel(const RasterTask& task, const Frame& frame, std::int64_t begin,
                     std::int64_t end, const GradientRows& to, double* dpose) {
  HWY_DYNAMIC_DISPATCH(Gradients)(task, frame, begin, end, to, dpose);
}

}  // namespace gsut
#endif
