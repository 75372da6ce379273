// Rendered depths are off by a third of a pixel of parallax, alike in all views, which fusion
// cannot average out; windows of the photographs show where their surface lies to a tenth of a
// pixel.
//
// A window's way into a neighbour is affine: three of its points go through the lens and shutter at
// two distances, and the tried distances lie on the line through both.
#include "gsut/surface/refine_depth.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "gsut/base/parallel.h"
#include "gsut/surface/window_scores.h"

namespace gsut {
namespace {

using Eigen::Map;
using Eigen::Vector3d;

constexpr std::int64_t kRows = 4;     // of pixels, that a thread takes at a time
constexpr double kLonger = 1.01;      // times the distance, at which windows are projected too
constexpr float kStep = 0.5F;         // pixels, of the most sensitive neighbour
constexpr float kLeastSlope = 10.0F;  // pixels by e times the distance: steps are 5 % at most
constexpr double kGrazing = 0.08;     // cosine below which a plane is seen edge-on
constexpr float kAlike = 0.6F;        // correlation above which a neighbour shows the same
constexpr float kSharp = 1e-5F;       // curvature of scores below which there is no maximum
constexpr int kCorners = 3;           // points of a window that are projected: middle, right, down
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// What all rows share; rows write to their own depths alone, so that threads change no bit.
// `packed` has the order of `others`.
struct Refinement {
  const DepthView& view;
  const std::vector<DepthView>& views;
  std::span<const std::size_t> others;
  PaddedGrey own;
  std::vector<PackedGrey> packed;  // of the others
  const float* normals;
  float* depth;
  std::uint8_t* moved;
};

// Buffers for some pixels of a row, and what is done with them, one step after the other.
class Windows {
 public:
  explicit Windows(const Refinement& all)
      : all_(all), corners_(2 * kCorners), places_(2 * kCorners), paths_(all.others.size()) {}

  // Moves the depths of `count` pixels of row y, from x0 on. What lies beyond the last pixel of a
  // vector is as if it had no depth.
  void Refine(int x0, int y, int count) {
    x0_ = x0, y_ = y, count_ = count;
    whole_ = (count + kWindowLanes - 1) / kWindowLanes * kWindowLanes;
    for (PointBatch& batch : corners_) {
      for (float* axis : {batch.x, batch.y, batch.z}) std::fill_n(axis, whole_, 0.0F);
    }
    active_.fill(false);
    for (int i = 0; i < count; ++i) active_[i] = PlaceWindow(i);
    if (std::none_of(active_.begin(), active_.end(), [](bool each) { return each; })) return;
    slope_.fill(kLeastSlope);
    for (std::size_t k = 0; k < paths_.size(); ++k) FindPaths(k);
    SumScores();
    for (int i = 0; i < count; ++i) Move(i);
  }

 private:
  // To the right and down, or the other way at the last pixels.
  int Right(int i) const { return x0_ + i + kWindowHalf < all_.view.width() ? 1 : -1; }
  int Down() const { return y_ + kWindowHalf < all_.view.height() ? 1 : -1; }
  std::size_t At(int i) const { return static_cast<std::size_t>(y_) * all_.view.width() + x0_ + i; }

  // The corners of a pixel's window, on its plane and on the same plane farther away: where their
  // own rays meet it, from their own origins and lines' poses. False where a pixel has no plane, a
  // plane seen edge-on, no texture, or no ray beside it.
  bool PlaceWindow(int i) {
    const DepthView& view = all_.view;
    const RayTable& rays = view.camera().Rays();
    const int x = x0_ + i;
    const double depth = all_.depth[At(i)];
    const Vector3d normal = Map<const Eigen::Vector3f>(all_.normals + 3 * At(i)).cast<double>();
    const double length = normal.norm();
    if (!(depth > 0.0 && depth < double{DepthSample::kFree}) || !(length > 0.0)) return false;
    if (!all_.own.IsTextured(x, y_)) return false;
    const int columns[kCorners] = {x, x + Right(i) * kWindowHalf, x};
    const int rows[kCorners] = {y_, y_, y_ + Down() * kWindowHalf};
    const Vector3d start = view.PointOf(x, y_, 0.0), along = view.PointOf(x, y_, 1.0) - start;
    for (int c = 0; c < kCorners; ++c) {
      if (columns[c] < 0 || rows[c] < 0) return false;
      const std::size_t at = static_cast<std::size_t>(rows[c]) * view.width() + columns[c];
      if (rays.valid[at] == 0) return false;
      const Vector3d from = view.PointOf(columns[c], rows[c], 0.0);
      const Vector3d ray = view.PointOf(columns[c], rows[c], 1.0) - from;
      const double cosine = ray.dot(normal);
      if (std::abs(cosine) < kGrazing * length) return false;
      for (const int far : {0, 1}) {
        const Vector3d middle = start + along * (far == 0 ? depth : depth * kLonger);
        const Vector3d point = from + (middle - from).dot(normal) / cosine * ray;
        PointBatch& batch = corners_[far * kCorners + c];
        batch.x[i] = static_cast<float>(point[0]);
        batch.y[i] = static_cast<float>(point[1]);
        batch.z[i] = static_cast<float>(point[2]);
      }
    }
    return true;
  }

  // The windows' ways into a neighbour, by the logarithm of the distance, which makes steps alike
  // near and far. They are straight over the few pixels that are tried. The most sensitive
  // neighbour sets the step, so that none jumps over its best distance.
  void FindPaths(std::size_t which) {
    for (int c = 0; c < 2 * kCorners; ++c) {
      all_.views[all_.others[which]].Project(whole_, corners_[c], &places_[c]);
    }
    const float per_log = static_cast<float>(1.0 / std::log(kLonger));
    WindowPaths& path = paths_[which];
    for (int i = 0; i < whole_; ++i) {
      const float right = static_cast<float>(Right(i)) / kWindowHalf;
      const float down = static_cast<float>(Down()) / kWindowHalf;
      std::array<std::array<float, WindowPaths::kNumbers>, 2> ends;  // in their order
      for (const int far : {0, 1}) {
        const ViewedBatch* at = &places_[far * kCorners];
        ends[far] = {at[0].u[i],
                     at[0].v[i],
                     (at[1].u[i] - at[0].u[i]) * right,
                     (at[1].v[i] - at[0].v[i]) * right,
                     (at[2].u[i] - at[0].u[i]) * down,
                     (at[2].v[i] - at[0].v[i]) * down};
      }
      // Without a place the window fails in all neighbours, as NaN fails all comparisons.
      for (int q = 0; q < WindowPaths::kNumbers; ++q) {
        path.at[q][i] = active_[i] ? ends[0][q] : kNaN;
        path.by[q][i] = (ends[1][q] - ends[0][q]) * per_log;
      }
      const float slope = std::hypot(path.by[WindowPaths::kU][i], path.by[WindowPaths::kV][i]);
      if (slope > slope_[i]) slope_[i] = slope;  // not NaN
    }
  }

  // The scores of all neighbours that show the same at one of the distances; others see something
  // else before it, or leave their photograph.
  void SumScores() {
    for (auto& row : total_.of) std::fill_n(row, whole_, 0.0F);
    for (std::size_t k = 0; k < paths_.size(); ++k) {
      for (auto& row : paths_[k].by) {
        for (int i = 0; i < whole_; ++i) row[i] *= kStep / slope_[i];
      }
      CorrelateWindows(all_.own, x0_, y_, whole_, all_.packed[k], paths_[k], &scores_);
      for (int i = 0; i < whole_; ++i) {
        float best = -1.0F, sum = 0.0F;
        for (const auto& row : scores_.of) best = std::max(best, row[i]), sum += row[i];
        if (!(best > kAlike) || std::isnan(sum)) continue;
        for (int t = 0; t < kWindowTries; ++t) total_.of[t][i] += scores_.of[t][i];
      }
    }
  }

  // Moves a depth to the top of a parabola through the best score and those beside it. At the ends
  // of the range scores may be larger beyond.
  void Move(int i) {
    int best = 0;
    for (int t = 1; t < kWindowTries; ++t) {
      if (total_.of[t][i] > total_.of[best][i]) best = t;
    }
    if (best == 0 || best == kWindowTries - 1) return;
    const float before = total_.of[best - 1][i], after = total_.of[best + 1][i];
    const float curve = before - 2.0F * total_.of[best][i] + after;
    if (!(curve < -kSharp)) return;
    const float part = 0.5F * (before - after) / curve;
    const float steps = static_cast<float>(best - kWindowTries / 2) + part;
    all_.depth[At(i)] *= std::exp(steps * kStep / slope_[i]);
    all_.moved[At(i)] = 1;
  }

  const Refinement& all_;
  int x0_ = 0, y_ = 0, count_ = 0, whole_ = 0;
  std::array<bool, kPointBatch> active_;
  std::array<float, kPointBatch> slope_;  // pixels by e times the distance, of all neighbours
  std::vector<PointBatch> corners_;
  std::vector<ViewedBatch> places_;
  std::vector<WindowPaths> paths_;
  WindowScores scores_, total_;
};

}  // namespace

void RefineDepth(const std::vector<DepthView>& views, std::size_t which,
                 std::span<const std::size_t> others, std::span<const float* const> greys,
                 const float* normals, float* depth, std::uint8_t* moved) {
  const DepthView& view = views[which];
  const int width = view.width(), height = view.height();
  Refinement all{view, views, others, {greys[which], width, height}, {}, normals, depth, moved};
  for (const std::size_t k : others) {
    all.packed.emplace_back(greys[k], views[k].width(), views[k].height());
  }
  std::fill_n(moved, static_cast<std::size_t>(width) * height, std::uint8_t{0});
  ParallelFor(height, kRows, [&](std::int64_t begin, std::int64_t end) {
    Windows windows(all);
    for (int y = static_cast<int>(begin); y < end; ++y) {
      for (int x0 = 0; x0 < width; x0 += kPointBatch) {
        windows.Refine(x0, y, std::min(kPointBatch, width - x0));
      }
    }
  });
}

}  // namespace gsut
