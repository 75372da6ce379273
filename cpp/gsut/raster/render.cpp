// The stages of a frame, one after the other.
#include "gsut/raster/render.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/gaussians/check_gaussians.h"
#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/harmonics.h"
#include "gsut/projection/project_kernels.h"
#include "gsut/raster/bin_tiles.h"
#include "gsut/raster/central/kernels.h"
#include "gsut/raster/lines/kernels.h"
#include "gsut/raster/sharp_records.h"
#include "gsut/raster/view_rays.h"

namespace gsut {
namespace {

constexpr std::size_t kPadding = 16;
constexpr const char* kTooWide =
    "the image is too small for its field of view: a tile of 16 x 16 pixels spans more than 168 "
    "degrees; render a larger image or use dtype=\"float64\"";

// Throws InputError for what only the double reference draws.
void CheckRule(const GaussiansView<const float>& gaussians, OrderKey order, bool with_channels) {
  if (order == OrderKey::kIntegral) {
    throw InputError(
        "order \"integral\" is drawn with dtype=\"float64\" only; in float32: distance, z, ray");
  }
  if (order == OrderKey::kRay && with_channels) {
    throw InputError(
        "features are blended in order \"ray\" with dtype=\"float64\" only; in float32: distance, "
        "z");
  }
  if (gaussians.response == Response::kDensity) {
    throw InputError(
        "response \"density\" is drawn with dtype=\"float64\" only; in float32: maximum, "
        "extinction");
  }
}

}  // namespace

// A frame in four stages, each parallel: project bounds every Gaussian's footprint, records makes
// 16 floats of each and lists the tiles it may touch, bin sorts by depth and deals the pairs out to
// the tiles, forward blends tile by tile. No stage adds in an order that depends on threads.
void Renderer::Render(const GaussiansView<const float>& gaussians, const RenderJob& job) {
  rendered_ = along_rays_ = stepped_ = false;
  CheckGaussians(gaussians);
  CheckGiven(job.image, "image");
  job.channels.Check(gaussians.size);
  const BlendRule rule = rule_ = job.settings.rule.For(gaussians.order);
  const bool along_ray = rule.order == OrderKey::kRay;
  job.settings.Check();
  CheckRule(gaussians, rule.order, job.channels.count > 0);
  ActiveIsa();  // applies GSUT_ISA before the first kernel runs
  timings_.clear();
  camera_ = std::make_unique<Camera>(job.camera);
  motion_ = job.motion;
  lines_ = nullptr;
  Stopwatch watch;
  // Rays that meet in one point are linear forms of a pixel's place in its tile; rays with origins
  // of their own are lines. So are all rays for what is rare: triangles, extinction, the order
  // along the ray and channels. Tiles and bounds follow from camera and motion alone and are kept
  // from frame to frame.
  const bool is_common = gaussians.primitive == Primitive::kGaussian &&
                         gaussians.response == Response::kMaximum && !along_ray &&
                         job.channels.count == 0 && !job.as_lines;
  if (is_common && HasOneCenter(job.camera, job.motion)) {
    grid_ = TilesOf(job.camera, ActiveLanes());
  } else {
    lines_ = LinesOf(job.camera, job.motion, ActiveLanes());
  }
  if (tiles().too_wide) throw InputError(kTooWide);
  FillTask(gaussians, job);
  // The ellipse of the unscented transform is where the search for tiles begins, never its result.
  // Lines have no such guess: they search a pyramid of bounds instead.
  if (lines_ == nullptr) {
    const FootprintRule footprint = {rule.alpha_min, rule.response_min};
    Project(gaussians, job.camera, job.motion.start, job.unscented, footprint, &splats_);
  } else {
    splats_.Resize(gaussians.size);
  }
  timings_.push_back(watch.Lap("project"));
  ResizeFrame(job.tiles);
  // Parts of a fixed size own the row spans of their Gaussians, so that no part waits for another.
  ParallelFor(gaussians.size, kRecordsPart, [&](std::int64_t begin, std::int64_t end) {
    frame_.row_spans[static_cast<std::size_t>(begin / kRecordsPart)].clear();
    if (lines_ == nullptr) {
      RecordsKernel(task_, *grid_, splats_, begin, end, &frame_);
    } else {
      LineRecordsKernel(task_, *lines_, begin, end, &frame_, &splats_);
      if (along_ray) LineRayOrderKeysKernel(task_, lines_->is_parallel, begin, end, &frame_);
    }
    if (job.tiles == nullptr) return;
    for (std::int64_t i = begin; i < end; ++i) {
      frame_.rects[static_cast<std::size_t>(i)].Prune(frame_.alive.data(), tiles().tiles_x);
    }
  });
  timings_.push_back(watch.Lap("records"));
  BinTiles(tiles(), &frame_);
  // What a tile blended is kept at the places of its pairs, for the backward pass and the scores.
  if (task_.channels.count > 0) {
    frame_.channels.resize(static_cast<std::size_t>(tiles().num_tiles()) * kTilePixels *
                           PaddedChannels(task_.channels.count));
  }
  if (task_.keep) {
    frame_.entries.resize(frame_.pairs.size());
    frame_.entry_count.resize(static_cast<std::size_t>(tiles().num_tiles()));
  }
  timings_.push_back(watch.Lap("bin"));
  ParallelFor(tiles().num_tiles(), 1, [&](std::int64_t index, std::int64_t) {
    const int tile = TileInOrder(index);
    if (lines_ == nullptr) {
      ForwardKernel(task_, *grid_, tile, &frame_, job.image, job.alpha, job.depth, job.distortion);
    } else if (along_ray) {
      LineRayOrderForwardKernel(task_, *lines_, tile, &frame_, job.image, job.alpha, job.depth,
                                job.distortion);
    } else if (task_.channels.count > 0) {
      LineChannelsForwardKernel(task_, *lines_, tile, &frame_, job.image, job.alpha, job.depth,
                                job.distortion, job.channel_image);
    } else {
      LineForwardKernel(task_, *lines_, tile, &frame_, job.image, job.alpha, job.depth,
                        job.distortion);
    }
  });
  timings_.push_back(watch.Lap("forward"));
  rendered_ = task_.keep;
  along_rays_ = along_ray && job.keep_for_backward;
}

void Renderer::CheckKept(bool kept, const char* without) const {
  if (kept) return;
  throw InputError(rule_.order != OrderKey::kRay
                       ? without
                       : "in float32 order \"ray\" has neither scores nor surfaces: render by "
                         "distance or z");
}

// What all kernels read of a job, rounded to float once. response_min bounds D^2 like the opacity
// does: exp(-D^2 / 2) > response_min where D^2 < -2 ln(response_min).
void Renderer::FillTask(const GaussiansView<const float>& gaussians, const RenderJob& job) {
  const RenderSettings& settings = job.settings;
  task_.gaussians = gaussians;
  reference_ = job.motion.Middle();
  std::copy_n(settings.background, 3, background_);
  task_.view = MakeViewFloats(reference_);
  task_.log2_raw_min = static_cast<float>(Log2RawOf(gaussians.response, rule_.alpha_min));
  task_.max_cutoff = rule_.response_min > 0.0
                         ? static_cast<float>(-2.0 * std::log(rule_.response_min))
                         : std::numeric_limits<float>::max();
  task_.alpha_max = static_cast<float>(rule_.alpha_max);
  task_.transmittance_min = static_cast<float>(rule_.transmittance_min);
  for (int c = 0; c < 3; ++c) task_.background[c] = static_cast<float>(settings.background[c]);
  task_.near_z = static_cast<float>(rule_.near_z);
  task_.far_z = static_cast<float>(rule_.far_z);
  task_.is_extinction = gaussians.response == Response::kExtinction;
  task_.order_by_z = rule_.order == OrderKey::kDepthZ;
  task_.stop_before = rule_.stop_before;
  task_.crossing = task_.transmittance_min;
  if (task_.stop_before) task_.crossing = std::nextafter(task_.crossing, 1.0f);
  task_.with_depth = job.WithDepth();
  task_.channels = job.channels;
  // Along the ray the backward pass makes its own.
  task_.keep = (job.keep_for_backward || job.channels.count > 0) && rule_.order != OrderKey::kRay;
  const int stored_degree = ShDegree(gaussians.sh_coefficients);
  task_.sh_degree = settings.sh_degree < stored_degree ? settings.sh_degree : stored_degree;
}

// Makes room for whole vectors beyond the last Gaussian, and takes the tiles that are not chosen
// out of the search.
void Renderer::ResizeFrame(const std::uint8_t* chosen) {
  frame_.size = task_.gaussians.size;
  const std::size_t n = static_cast<std::size_t>(frame_.size);
  frame_.records.resize((n + kPadding) * record::kSize);
  frame_.mean_direction.resize((n + kPadding) * kDirectionSize);
  frame_.order_key.resize(n + kPadding);
  frame_.rects.resize(n);
  frame_.row_spans.resize((n + kRecordsPart - 1) / kRecordsPart);
  frame_.alive = tiles().alive;
  for (std::size_t tile = 0; chosen != nullptr && tile < frame_.alive.size(); ++tile) {
    if (chosen[tile] == 0) frame_.alive[tile] = 0;
  }
  const std::size_t pixels = static_cast<std::size_t>(tiles().num_tiles()) * kTilePixels;
  frame_.transmittance.resize(pixels);
  for (AlignedVector<float>& channel : frame_.color) channel.resize(pixels);
  if (!task_.with_depth) return;
  frame_.depth.resize(pixels);
  frame_.first_depth.resize(pixels);
  frame_.depth_moment.resize(pixels);
}

std::int64_t Renderer::num_contributing_pairs() const {
  std::int64_t sum = 0;
  if (rendered_) {
    for (const std::uint32_t count : frame_.entry_count) sum += count;
  }
  return sum;
}

std::int64_t Renderer::buffer_bytes() const {
  std::size_t sum = 0;
  const auto add = [&](const auto&... vectors) {
    ((sum += vectors.capacity() * sizeof(*vectors.data())), ...);
  };
  const Splats& s = splats_;
  add(s.u, s.v, s.cov_uu, s.cov_uv, s.cov_vv, s.extent_u, s.extent_v, s.distance, s.sine, s.status);
  const Frame& f = frame_;
  add(f.records, f.mean_direction, f.order_key, f.rects, f.slot_begin, f.order, f.pairs,
      f.tile_begin, f.transmittance, f.color[0], f.color[1], f.color[2], f.depth, f.first_depth,
      f.depth_moment, f.channels, f.entries, f.entry_count, f.slot_gradients, f.slot_touched);
  for (const std::vector<RowSpan>& spans : f.row_spans) add(spans);
  return static_cast<std::int64_t>(sum);
}

}  // namespace gsut
