// The kernels for lines, compiled once per instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/raster/lines/kernels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <memory>
#include <vector>

#include "gsut/gaussians/harmonics.h"
#include "gsut/raster/lines/kernels.h"

#include "gsut/raster/lines/tiles-inl.h"
#include "gsut/raster/lines/forward-inl.h"
#include "gsut/raster/lines/backward-inl.h"
#include "gsut/raster/lines/gradients-inl.h"
#include "gsut/raster/harmonics-inl.h"
#include "gsut/raster/pixels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// A standard deviation beyond this (world units) is taken as this: a wall all the same, and squares
// of it and of its inverse stay in float's range.
inline constexpr double kLargestScale = 1e15;

// Records of lines, a Gaussian a lane: 1. into the reference's frame; 2. colour in the direction
// from the reference; 3. mean and whitening, 16 floats; 4. one Gaussian at a time down the pyramid
// for its tiles. What is not finite is left out here, so that the later stages need no test.
void LineRecords(const RasterTask& task, const LineGrid& grid, std::int64_t begin, std::int64_t end,
                 Frame* frame, Splats* splats) {
  const FloatTag d;
  const auto rows = std::make_unique_for_overwrite<TouchedRows>();
  std::vector<RowSpan>* spans = &frame->row_spans[static_cast<std::size_t>(begin / kRecordsPart)];
  for (std::int64_t i = begin; i < end; i += kLanes) {
    const int count = static_cast<int>(HWY_MIN(end - i, static_cast<std::int64_t>(kLanes)));
    const NextHarmonics next(task.gaussians, i);
    const SeenLanes g = LoadSeen(task.gaussians, i, task.view, task.log2_raw_min, task.max_cutoff);
    Lane direction[3], color[3];
    ShadingDirection(g, task.view, grid.is_parallel, direction);
    ColorOf(task.gaussians, task.sh_degree, i, direction, color);
    const LaneMask in_range =
        AndMask(g.mean[2] >= Lane(task.near_z), g.mean[2] <= Lane(task.far_z));
    Lane columns[record::kSize];
    Lane sum = color[0] + color[1] + color[2] + g.mean[0] + g.mean[1] + g.mean[2];
    for (int k = 0; k < 3; ++k) {
      columns[line_record::kMean + k] = g.mean[k];
      const Lane inverse_scale = Lane(1.0) / Min(g.scale[k], Lane(kLargestScale));
      // A square of what is stored must be a number, too.
      sum += inverse_scale * inverse_scale;
      for (int j = 0; j < 3; ++j) {
        columns[line_record::kWhiten + 3 * k + j] = g.axes[k][j] * inverse_scale;
      }
      columns[line_record::kColor + k] = Max(color[k], Lane(0.0));
    }
    columns[line_record::kLog2Strength] = g.log2_strength;
    StoreColumns(columns, record::kSize, count,
                 &frame->records[static_cast<std::size_t>(i) * record::kSize]);
    const bool by_z = task.order_by_z || grid.is_parallel;
    hn::StoreU((by_z ? g.mean[2] : g.distance).v, d,
               &frame->order_key[static_cast<std::size_t>(i)]);
    hn::StoreU(g.distance.v, d, &splats->distance[static_cast<std::size_t>(i)]);
    LaneMask visible = AndMask(AndMask(g.usable, in_range), IsFinite(sum));
    // Centred on the reference: nothing to shade it by.
    if (!grid.is_parallel) visible = AndMask(visible, g.distance > Lane(0.0));
    const std::uint64_t bits = MaskBits(visible.m);
    for (int k = 0; k < count; ++k) {
      if (k < next.count) next.Fetch<false>(task.gaussians.sh, k, next.stride);
      const std::size_t j = static_cast<std::size_t>(i + k);
      frame->rects[j] = {};
      splats->status[j] = SplatStatus::kUnseen;
      if (!((bits >> k) & 1)) continue;
      const float* row = &frame->records[j * record::kSize];
      frame->rects[j] = LineTileRect(task, grid, row, rows.get(), spans);
      if (frame->rects[j].x0 < frame->rects[j].x1) splats->status[j] = SplatStatus::kUncertain;
    }
  }
}

// The tile's kernel evaluates responses, BlendTile blends them, whatever the kind of rays.
void LineForward(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame, float* image,
                 float* alpha, float* depth, float* distortion) {
  WithFlag(task.with_depth, [&](auto with_depth) HWY_ATTR {
    WithLineKernel(task, grid, tile, *frame, [&](auto& kernel) HWY_ATTR {
      BlendTile(with_depth, task, grid.tiles, tile, kernel, frame);
    });
  });
  WritePixels(grid.tiles, tile, *frame, task.background, task.with_depth, image, alpha, depth,
              distortion);
}

void LineBackward(const RasterTask& task, const LineGrid& grid, int tile,
                  const ImageGradients& gradients, Frame* frame, float* to_lines) {
  // Seven gradients a pixel: three colours, T_end, depth, distortion, and the error.
  HWY_ALIGN float buffer[7 * kTilePixels];
  const PixelGradients pixels =
      ReadPixelGradients(grid.tiles, tile, gradients, task.background, buffer);
  const bool with_rays = to_lines != nullptr, with_error = gradients.error != nullptr;
  WithFlag(gradients.HasDepth(), [&](auto with_depth) HWY_ATTR {
    BackwardLines({with_depth, with_rays, with_error}, task, grid, tile, KeptPairs(*frame, tile),
                  pixels, frame, to_lines);
  });
}

void LineGradientsRange(const RasterTask& task, bool is_parallel, const Frame& frame,
                        std::int64_t begin, std::int64_t end, const GradientRows& to,
                        double* dshading) {
  for (std::int64_t i = begin; i < end; i += kLanes) {
    LineGradients(task, is_parallel, i, frame, to, dshading);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(LineRecords);
HWY_EXPORT(LineForward);
HWY_EXPORT(LineBackward);
HWY_EXPORT(LineGradientsRange);

void LineRecordsKernel(const RasterTask& task, const LineGrid& grid, std::int64_t begin,
                       std::int64_t end, Frame* frame, Splats* splats) {
  HWY_DYNAMIC_DISPATCH(LineRecords)(task, grid, begin, end, frame, splats);
}

void LineForwardKernel(const RasterTask& task, const LineGrid& grid, int tile, Frame* frame,
                       float* image, float* alpha, float* depth, float* distortion) {
  HWY_DYNAMIC_DISPATCH(LineForward)(task, grid, tile, frame, image, alpha, depth, distortion);
}

void LineBackwardKernel(const RasterTask& task, const LineGrid& grid, int tile,
                        const ImageGradients& gradients, Frame* frame, float* to_lines) {
  HWY_DYNAMIC_DISPATCH(LineBackward)(task, grid, tile, gradients, frame, to_lines);
}

void LineGradientsKernel(const RasterTask& task, bool is_parallel, const Frame& frame,
                         std::int64_t begin, std::int64_t end, const GradientRows& to,
                         double* dshading) {
  HWY_DYNAMIC_DISPATCH(LineGradientsRange)
  (task, is_parallel, frame, begin, end, to, dshading);
}

}  // namespace gsut
#endif
