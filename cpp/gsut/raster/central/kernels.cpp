// The raster kernels, compiled once per instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/raster/central/kernels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <cmath>
#include <memory>
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

TileRect TilesOfSplat(const TileGrid& grid, const Splats& splats, std::size_t j, const float* row,
                      TouchedRows* rows, std::vector<RowSpan>* spans) {
  const SplatStatus status = splats.status[j];
  if (status == SplatStatus::kUncertain) return ExactTileRect(grid, row, rows, spans);
  const bool is_small = status == SplatStatus::kSmall;
  constexpr float kRounding = 0.01f;  // pixels: of float coordinates up to 65 536
  const float extent_u = splats.extent_u[j], extent_v = splats.extent_v[j];
  const float widen =
      kRounding + (is_small ? BendMargin(splats.sine[j], extent_u, extent_v) : 0.0f);
  const TileWindow window =
      EllipseTiles(grid, splats.u[j], splats.v[j], extent_u + widen, extent_v + widen);
  if (is_small) return BoundedTileRect(grid, row, window, rows, spans);
  return GrownTileRect(grid, row, window, rows, spans);
}

void Records(const RasterTask& task, const TileGrid& grid, const Splats& splats, std::int64_t begin,
             std::int64_t end, Frame* frame) {
  const FloatTag d;
  const hn::RebindToSigned<FloatTag> di;
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
    FetchNextHarmonics<false>(task.gaussians.sh, task.sh_rows, i);
    const SeenLanes g =
        LoadSeen(task.gaussians, i, task.view, task.log2_alpha_min, task.max_cutoff);
    const RecordLanes r = MakeRecord(g);
    Lane direction[3], color[3];
    const Lane inverse_distance = Lane(1.0) / g.distance;
    for (int k = 0; k < 3; ++k) direction[k] = g.world[k] * inverse_distance;
    const BatchHarmonics sh = HarmonicsOf(task.sh_rows, task.sh_degree, i);
    const auto row_offset =
        hn::Mul(hn::Min(hn::Iota(di, 0), hn::Set(di, count - 1)), hn::Set(di, 3 * sh.coefficients));
    EvalColor(sh.degree, direction, task.gaussians.sh + sh.offset, row_offset, color);
    const LaneMask in_range =
        AndMask(g.mean[2] >= Lane(task.near_z), g.mean[2] <= Lane(task.far_z));
    const LaneMask finite_color = IsFinite(color[0] + color[1] + color[2]);
    const std::uint64_t visible = MaskBits(AndMask(AndMask(r.visible, in_range), finite_color).m);
    const Lane steepest = Max(Dot3(r.a, r.a), Dot3(r.b, r.b));
    const std::uint64_t sharp = MaskBits((steepest > Lane(double{kSharpForm} * kSharpForm)).m);
    const Lane* columns[] = {&r.a[0], &r.a[1], &r.a[2], &r.b[0],    &r.b[1],  &r.b[2],
                             &r.c[0], &r.c[1], &r.c[2], &r.k,       &r.kappa, &g.log2_opacity,
                             nullptr, nullptr, nullptr, &g.distance};
    HWY_ALIGN float values[record::kSize][kLanes];
    for (int k = 0; k < record::kSize; ++k) {
      if (columns[k] != nullptr) hn::Store(columns[k]->v, d, values[k]);
    }
    for (int c = 0; c < 3; ++c) {
      hn::Store(Max(color[c], Lane(0.0)).v, d, values[record::kColor + c]);
    }
    hn::StoreU((task.order_by_z ? g.mean[2] : g.distance).v, d,
               &frame->order_key[static_cast<std::size_t>(i)]);
    for (int k = 0; k < count; ++k) {
      const std::size_t j = static_cast<std::size_t>(i + k);
      if (!((visible >> k) & 1) || splats.status[j] == SplatStatus::kUnseen) continue;
      float* row = &frame->records[j * record::kSize];
      for (int column = 0; column < record::kSize; ++column) row[column] = values[column][k];
      if ((sharp >> k) & 1) {
        row[record::kDepth] = -row[record::kDepth];
        ExactDirection(task.view, task.gaussians.means + 3 * j,
                       &frame->mean_direction[j * kDirectionSize]);
      }
      frame->rects[j] = TilesOfSplat(grid, splats, j, row, rows.get(), spans);
    }
  }
}

void Forward(const RasterTask& task, const TileGrid& grid, int tile, Frame* frame, float* image,
             float* alpha, float* depth, float* distortion) {
  WithFlag(task.with_depth, [&](auto with_depth) HWY_ATTR {
    WithFlag(task.stop_before, [&](auto stop_before) HWY_ATTR {
      ForwardTile(with_depth, stop_before, grid, tile, task.alpha_max, task.transmittance_min,
                  task.keep, frame);
    });
  });
  WritePixels(grid, tile, *frame, task.background, task.with_depth, image, alpha, depth,
              distortion);
}

void Backward(const RasterTask& task, const TileGrid& grid, int tile,
              const ImageGradients& gradients, Frame* frame, float* to_rays) {
  HWY_ALIGN float buffer[6 * kTilePixels];
  const PixelGradients pixels = ReadPixelGradients(grid, tile, gradients, task.background, buffer);
  WithFlag(gradients.HasDepth(), [&](auto with_depth) HWY_ATTR {
    WithFlag(task.stop_before, [&](auto stop_before) HWY_ATTR {
      WithFlag(to_rays != nullptr, [&](auto with_rays) HWY_ATTR {
        BackwardTile(with_depth, stop_before, with_rays, grid, tile, task.alpha_max,
                     task.transmittance_min, pixels, frame, to_rays);
      });
    });
  });
}

void Gradients(const RasterTask& task, const Frame& frame, std::int64_t begin, std::int64_t end,
               bool write_untouched, const GaussiansView<float>& gradients, std::uint8_t* touched,
               double* dpose) {
  for (std::int64_t i = begin; i < end; i += kLanes) {
    GaussianGradients(task.gaussians, task.sh_rows, i, task.view, task.log2_alpha_min,
                      task.max_cutoff, task.sh_degree, write_untouched, frame, gradients, touched,
                      dpose);
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
                     std::int64_t end, bool write_untouched, const GaussiansView<float>& gradients,
                     std::uint8_t* touched, double* dpose) {
  HWY_DYNAMIC_DISPATCH(Gradients)
  (task, frame, begin, end, write_untouched, gradients, touched, dpose);
}

}  // namespace gsut
#endif
