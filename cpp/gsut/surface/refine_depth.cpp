// Rendered depths are off by a third of a pixel of parallax, alike in all views, which fusion
// cannot average out; windows of the photographs show where their surface lies to a tenth of a
// pixel.
//
// Vector lanes are neighbouring pixels of a row, so that each sees its own window and the order of
// its sums is fixed. A window's way into a neighbour is affine: three of its points go through the
// lens and shutter at two distances, and the tried distances lie on the line through both. Grey
// values are packed in pairs of 15 bits and a bit that says whether the pixel may be looked at.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/surface/refine_depth.cpp"
#include "gsut/base/hwy_targets.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "gsut/base/parallel.h"
#include "gsut/surface/refine_depth.h"
#include "gsut/surface/window_buffers.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

constexpr float kLevels = 32767.0F;  // of 15 bits
constexpr float kNoise = 1e-5F;      // variance of noise, squared grey values
constexpr float kCount = (2 * kWindowHalf + 1) * (2 * kWindowHalf + 1);

}  // namespace

// Correlations of `count` (a multiple of kWindowLanes) pixels that start at `own`, a place in a
// padded photograph of `stride` floats a row, with one neighbour; NaN where a window leaves a
// photograph.
void Correlate(int count, const float* own, std::int64_t stride, const PackedGrey& other,
               const WindowPaths& paths, WindowScores* scores) {
  const hn::ScalableTag<float> f;
  const hn::RebindToSigned<decltype(f)> n;
  const auto half = hn::Set(f, 0.5F), one = hn::Set(f, 1.0F), share = hn::Set(f, 1.0F / kCount);
  const auto noise = hn::Set(f, kNoise), level = hn::Set(f, 1.0F / kLevels);
  const auto low = hn::Set(n, 0x7FFF), width = hn::Set(n, other.width);
  const auto right = hn::Set(f, static_cast<float>(other.width) - 1.0F);
  const auto bottom = hn::Set(f, static_cast<float>(other.height) - 1.0F);
  const auto seen = hn::Set(n, static_cast<std::int32_t>(0x80008000U));
  const auto reach = hn::Set(f, static_cast<float>(kWindowHalf));
  const auto nothing = hn::Set(f, std::numeric_limits<float>::quiet_NaN());
  for (int i = 0; i < count; i += static_cast<int>(hn::Lanes(f))) {
    // Both windows are taken about the pixel's own value, so that float sums keep their digits.
    const auto middle = hn::LoadU(f, own + i);
    auto sum = hn::Zero(f), squares = hn::Zero(f);
    for (int dy = -kWindowHalf; dy <= kWindowHalf; ++dy) {
      for (int dx = -kWindowHalf; dx <= kWindowHalf; ++dx) {
        const auto mine = hn::Sub(hn::LoadU(f, own + i + dy * stride + dx), middle);
        sum = hn::Add(sum, mine);
        squares = hn::MulAdd(mine, mine, squares);
      }
    }
    const auto mean = hn::Mul(sum, share);
    const auto variance = hn::Add(hn::Sub(hn::Mul(squares, share), hn::Mul(mean, mean)), noise);
    for (int k = 0; k < kWindowTries; ++k) {
      const auto step = hn::Set(f, static_cast<float>(k - kWindowTries / 2));
      const auto path = [&](int which) {
        return hn::MulAdd(step, hn::Load(f, paths.by[which] + i), hn::Load(f, paths.at[which] + i));
      };
      const auto u = path(0), v = path(1);
      const auto right_u = path(2), right_v = path(3), down_u = path(4), down_v = path(5);
      const auto far_u = hn::Mul(reach, hn::Add(hn::Abs(right_u), hn::Abs(down_u)));
      const auto far_v = hn::Mul(reach, hn::Add(hn::Abs(right_v), hn::Abs(down_v)));
      auto in = hn::And(hn::Ge(hn::Sub(u, far_u), one), hn::Le(hn::Add(u, far_u), right));
      in = hn::And(in, hn::And(hn::Ge(hn::Sub(v, far_v), one), hn::Le(hn::Add(v, far_v), bottom)));
      in = hn::And(in, hn::Eq(variance, variance));
      if (hn::AllFalse(f, in)) {
        hn::Store(nothing, f, scores->of[k] + i);
        continue;
      }
      // Places of lanes that are not `in` are the first pixel, so that gathers stay inside.
      // Of a masked pixel the upper bit of its half is 0, and stays so in `shown`.
      auto theirs = hn::Zero(f), their_squares = hn::Zero(f), both = hn::Zero(f);
      auto shown = seen;
      for (int dy = -kWindowHalf; dy <= kWindowHalf; ++dy) {
        const auto row = hn::Set(f, static_cast<float>(dy));
        const auto row_u = hn::Sub(hn::MulAdd(row, down_u, u), half);
        const auto row_v = hn::Sub(hn::MulAdd(row, down_v, v), half);
        for (int dx = -kWindowHalf; dx <= kWindowHalf; ++dx) {
          const auto column = hn::Set(f, static_cast<float>(dx));
          const auto x = hn::IfThenElseZero(in, hn::MulAdd(column, right_u, row_u));
          const auto y = hn::IfThenElseZero(in, hn::MulAdd(column, right_v, row_v));
          const auto left = hn::ConvertTo(n, x), top = hn::ConvertTo(n, y);
          const auto s = hn::Sub(x, hn::ConvertTo(f, left));
          const auto t = hn::Sub(y, hn::ConvertTo(f, top));
          const auto place = hn::Add(hn::Mul(top, width), left);
          const auto above = hn::GatherIndex(n, other.pairs.data(), place);
          const auto below = hn::GatherIndex(n, other.pairs.data() + other.width, place);
          shown = hn::And(shown, hn::And(above, below));
          const auto a = hn::ConvertTo(f, hn::And(above, low));
          const auto b = hn::ConvertTo(f, hn::And(hn::ShiftRight<16>(above), low));
          const auto c = hn::ConvertTo(f, hn::And(below, low));
          const auto d = hn::ConvertTo(f, hn::And(hn::ShiftRight<16>(below), low));
          const auto upper = hn::MulAdd(s, hn::Sub(b, a), a);
          const auto lower = hn::MulAdd(s, hn::Sub(d, c), c);
          const auto value = hn::MulAdd(t, hn::Sub(lower, upper), upper);
          const auto their = hn::MulSub(value, level, middle);
          const auto mine = hn::Sub(hn::LoadU(f, own + i + dy * stride + dx), middle);
          theirs = hn::Add(theirs, their);
          their_squares = hn::MulAdd(their, their, their_squares);
          both = hn::MulAdd(mine, their, both);
        }
      }
      const auto their_mean = hn::Mul(theirs, share);
      const auto their_variance =
          hn::Add(hn::Sub(hn::Mul(their_squares, share), hn::Mul(their_mean, their_mean)), noise);
      const auto together = hn::Sub(hn::Mul(both, share), hn::Mul(mean, their_mean));
      const auto alike = hn::Div(together, hn::Sqrt(hn::Mul(variance, their_variance)));
      const auto all = hn::And(in, hn::RebindMask(f, hn::Eq(shown, seen)));
      hn::Store(hn::IfThenElse(all, alike, nothing), f, scores->of[k] + i);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
namespace {

HWY_EXPORT(Correlate);

using Eigen::Map;
using Eigen::Vector3d;

constexpr std::int64_t kRows = 4;     // of pixels, that a thread takes at a time
constexpr double kLonger = 1.01;      // times the distance, at which windows are projected too
constexpr float kStep = 0.5F;         // pixels, of the most sensitive neighbour
constexpr float kLeastSlope = 10.0F;  // pixels by e times the distance: steps are 5 % at most
constexpr double kGrazing = 0.08;     // cosine below which a plane is seen edge-on
constexpr float kContrast = 0.008F;   // standard deviation of a window below which it is plain
constexpr float kAlike = 0.6F;        // correlation above which a neighbour shows the same
constexpr float kSharp = 1e-5F;       // curvature of scores below which there is no maximum
constexpr int kCorners = 3;           // points of a window that are projected: middle, right, down
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

// Where windows are looked up: a pixel and the one to its right in one number, so that a place
// takes two gathers in place of four. The last column is its own neighbour; windows end before it.
PackedGrey Pack(const float* grey, int width, int height) {
  PackedGrey packed{width, height, {}};
  packed.pairs.resize(static_cast<std::size_t>(width) * height);
  const auto bits = [&](int x, int y) -> std::uint32_t {
    const float value = grey[static_cast<std::size_t>(y) * width + std::min(x, width - 1)];
    if (!(value >= 0.0F)) return 0;  // NaN
    return 0x8000U | static_cast<std::uint32_t>(std::min(value, 1.0F) * 32767.0F + 0.5F);
  };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      packed.pairs[static_cast<std::size_t>(y) * width + x] =
          static_cast<std::int32_t>(bits(x, y) | bits(x + 1, y) << 16);
    }
  }
  return packed;
}

// A photograph with a border of NaN, in which windows fail.
class PaddedGrey {
 public:
  PaddedGrey(const float* grey, int width, int height)
      : stride_(width + 2 * kWindowHalf + kPointBatch),
        values_(static_cast<std::size_t>(stride_) * (height + 2 * kWindowHalf), kNaN) {
    for (int y = 0; y < height; ++y) {
      std::copy_n(grey + static_cast<std::size_t>(y) * width, width, &values_[Index(0, y)]);
    }
  }
  const float* At(int x, int y) const { return &values_[Index(x, y)]; }
  std::int64_t stride() const { return stride_; }

  // Whether the window around a pixel has any texture; false at borders.
  bool IsTextured(int x, int y) const {
    const float* at = At(x, y);
    float sum = 0.0F, squares = 0.0F;
    for (int dy = -kWindowHalf; dy <= kWindowHalf; ++dy) {
      for (int dx = -kWindowHalf; dx <= kWindowHalf; ++dx) {
        const float off = at[dy * stride_ + dx] - at[0];
        sum += off;
        squares += off * off;
      }
    }
    const float count = (2 * kWindowHalf + 1) * (2 * kWindowHalf + 1);
    return squares / count - sum / count * (sum / count) > kContrast * kContrast;
  }

 private:
  std::size_t Index(int x, int y) const {
    return static_cast<std::size_t>((y + kWindowHalf) * stride_ + kWindowHalf + x);
  }
  std::int64_t stride_;
  std::vector<float> values_;
};

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
      std::array<std::array<float, 6>, 2> ends;
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
      for (int q = 0; q < 6; ++q) {
        path.at[q][i] = active_[i] ? ends[0][q] : kNaN;
        path.by[q][i] = (ends[1][q] - ends[0][q]) * per_log;
      }
      const float slope = std::hypot(path.by[0][i], path.by[1][i]);
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
      HWY_DYNAMIC_DISPATCH(Correlate)
      (whole_, all_.own.At(x0_, y_), all_.own.stride(), all_.packed[k], paths_[k], &scores_);
      for (int i = 0; i < whole_; ++i) {
        float best = -1.0F, sum = 0.0F;
        for (const auto& row : scores_.of) best = std::max(best, row[i]), sum += row[i];
        if (!(best > kAlike) || std::isnan(sum)) continue;
        for (int t = 0; t < kWindowTries; ++t) total_.of[t][i] += scores_.of[t][i];
      }
    }
  }

  // The best score must lie within the range: at its ends it may be larger beyond.
  // Moves a depth to the top of a parabola through the best score and those beside it.
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
    all.packed.push_back(Pack(greys[k], views[k].width(), views[k].height()));
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
#endif  // HWY_ONCE
