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
#include <limits>

#include "gsut/base/parallel.h"
#include "gsut/surface/refine_depth.h"

#ifndef GSUT_SURFACE_REFINE_DEPTH
#define GSUT_SURFACE_REFINE_DEPTH
namespace gsut {

constexpr int kWindowHalf = 3;    // of the windows: 7 x 7 pixels
constexpr int kWindowTries = 5;   // distances
constexpr int kWindowLanes = 16;  // pixels that buffers of rows are padded by

// A photograph with a border, so that windows need no tests: each number holds a pixel and the one
// to its right.
struct PackedGrey {
  int width = 0, height = 0;
  std::vector<std::int32_t> pairs;
};

// The windows of some pixels of a row in one neighbour: place of the middle, steps to the right and
// down, each at the first distance and by tried distance.
struct WindowPaths {
  alignas(64) float at[6][kPointBatch], by[6][kPointBatch];
};

struct WindowScores {
  alignas(64) float of[kWindowTries][kPointBatch];
};

}  // namespace gsut
#endif

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

constexpr float kLevels = 32767.0F;  // of 15 bits
constexpr float kNoise = 1e-5F;      // variance of noise, squared grey values
constexpr float kCount = (2 * kWindowHalf + 1) * (2 * kWindowHalf + 1);

}  // namespace

// Correlations of `count` pixels that start at `own`, a place in a padded photograph of `stride`
// floats a row, with one neighbour; NaN where a window leaves a photograph.
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
      const auto their_variance = hn::Add(
          hn::Sub(hn::Mul(their_squares, share), hn::Mul(their_mean, their_mean)), noise);
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

constexpr std::int64_t kRows = 4;       // of pixels, that a thread takes at a time
constexpr double kLonger = 1.01;        // times the distance, at which windows are projected too
constexpr float kStep = 0.5F;           // pixels, of the most sensitive neighbour
constexpr float kLeastSlope = 10.0F;    // pixels by e times the distance: steps are 5 % at most
constexpr double kGrazing = 0.08;       // cosine, below which a plane is seen edge-on
constexpr float kContrast = 0.008F;     // standard deviation of a window below which it is plain
constexpr float kAlike = 0.6F;          // correlation above which a neighbour shows the same
constexpr float kSharp = 1e-5F;         // curvature of scores below which there is no maximum
constexpr int kCorners = 3;             // of a window that are projected: middle, right, down

PackedGrey Pack(const float* grey, int width, int height) {
  PackedGrey packed{width, height, {}};
  packed.pairs.resize(static_cast<std::size_t>(width) * height);
  const auto bits = [&](int x, int y) -> std::uint32_t {
    const float value = grey[static_cast<std::size_t>(y) * width + std::min(x, width - 1)];
    if (!(value >= 0.0F)) return 0;
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

// The photograph with a border of NaN, in which windows fail.
struct PaddedGrey {
  PaddedGrey(const float* grey, int width, int height)
      : stride(width + 2 * kWindowHalf + kPointBatch),
        values(static_cast<std::size_t>(stride) * (height + 2 * kWindowHalf),
               std::numeric_limits<float>::quiet_NaN()) {
    for (int y = 0; y < height; ++y) {
      std::copy_n(grey + static_cast<std::size_t>(y) * width, width, At(0, y));
    }
  }
  float* At(int x, int y) {
    return values.data() + static_cast<std::size_t>(y + kWindowHalf) * stride + kWindowHalf + x;
  }
  std::int64_t stride;
  std::vector<float> values;
};

}  // namespace

// Standard deviation of the window around a pixel; NaN at borders.
float Deviation(const float* at, std::int64_t stride) {
  float sum = 0.0F, squares = 0.0F;
  for (int y = -kWindowHalf; y <= kWindowHalf; ++y) {
    for (int x = -kWindowHalf; x <= kWindowHalf; ++x) {
      const float off = at[y * stride + x] - at[0];
      sum += off;
      squares += off * off;
    }
  }
  const float count = (2 * kWindowHalf + 1) * (2 * kWindowHalf + 1);
  const float mean = sum / count;
  return std::sqrt(std::max(0.0F, squares / count - mean * mean) + 0.0F * sum);
}

void RefineDepth(const std::vector<DepthView>& views, std::size_t which,
                 std::span<const std::size_t> others, std::span<const float* const> greys,
                 const float* normals, float* depth, std::uint8_t* moved) {
  const DepthView& view = views[which];
  const int width = view.width(), height = view.height();
  PaddedGrey own(greys[which], width, height);
  std::vector<PackedGrey> packed;
  for (const std::size_t k : others) {
    packed.push_back(Pack(greys[k], views[k].width(), views[k].height()));
  }
  const RayTable& rays = view.camera().Rays();
  std::fill_n(moved, static_cast<std::size_t>(width) * height, std::uint8_t{0});
  ParallelFor(height, kRows, [&](std::int64_t begin, std::int64_t end) {
    std::vector<PointBatch> corners(2 * kCorners);
    std::vector<WindowPaths> paths(others.size());
    std::vector<ViewedBatch> places(2 * kCorners);
    WindowScores scores;
    for (int y = static_cast<int>(begin); y < end; ++y) {
      for (int x0 = 0; x0 < width; x0 += kPointBatch) {
        const int count = std::min(kPointBatch, width - x0);
        const int whole = (count + kWindowLanes - 1) / kWindowLanes * kWindowLanes;
        std::array<bool, kPointBatch> active;
        for (int i = 0; i < whole; ++i) {
          active[i] = false;
          for (auto& c : corners) c.x[i] = c.y[i] = c.z[i] = 0.0F;
          if (i >= count) continue;
          const int x = x0 + i;
          const std::size_t at = static_cast<std::size_t>(y) * width + x;
          const double d = depth[at];
          const Vector3d normal = Map<const Eigen::Vector3f>(normals + 3 * at).cast<double>();
          const double length = normal.norm();
          if (!(d > 0.0) || !(d < 1e20) || !(length > 0.0)) continue;
          if (!(Deviation(own.At(x, y), own.stride) > kContrast)) continue;
          const int right = x + kWindowHalf < width ? 1 : -1;
          const int down = y + kWindowHalf < height ? 1 : -1;
          const int columns[kCorners] = {x, x + right * kWindowHalf, x};
          const int rows[kCorners] = {y, y, y + down * kWindowHalf};
          const Vector3d start = view.PointOf(x, y, 0.0);
          const Vector3d along = view.PointOf(x, y, 1.0) - start;
          bool good = true;
          for (int c = 0; c < kCorners; ++c) {
            good = good && columns[c] >= 0 && rows[c] >= 0 &&
                   rays.valid[static_cast<std::size_t>(rows[c]) * width + columns[c]] != 0;
            if (!good) break;
            const Vector3d from = view.PointOf(columns[c], rows[c], 0.0);
            const Vector3d ray = view.PointOf(columns[c], rows[c], 1.0) - from;
            const double cosine = ray.dot(normal) / length;
            good = std::abs(cosine) >= kGrazing;
            if (!good) break;
            for (int far = 0; far < 2; ++far) {
              const Vector3d middle = start + along * (far == 0 ? d : d * kLonger);
              const double s = (middle - from).dot(normal) / length / cosine;
              const Vector3d point = from + s * ray;
              PointBatch& batch = corners[far * kCorners + c];
              batch.x[i] = static_cast<float>(point[0]);
              batch.y[i] = static_cast<float>(point[1]);
              batch.z[i] = static_cast<float>(point[2]);
            }
          }
          active[i] = good;
        }
        if (std::none_of(active.begin(), active.begin() + whole, [](bool a) { return a; })) {
          continue;
        }
        std::array<float, kPointBatch> slope;
        slope.fill(0.0F);
        const float per_log = static_cast<float>(1.0 / std::log(kLonger));
        for (std::size_t k = 0; k < others.size(); ++k) {
          for (int c = 0; c < 2 * kCorners; ++c) {
            views[others[k]].Project(whole, corners[c], &places[c]);
          }
          WindowPaths& path = paths[k];
          for (int i = 0; i < whole; ++i) {
            const int x = x0 + i;
            const float right = (x + kWindowHalf < width ? 1.0F : -1.0F) / kWindowHalf;
            const float down = (y + kWindowHalf < height ? 1.0F : -1.0F) / kWindowHalf;
            float ends[2][6];
            for (int far = 0; far < 2; ++far) {
              const ViewedBatch* at = &places[far * kCorners];
              ends[far][0] = at[0].u[i];
              ends[far][1] = at[0].v[i];
              ends[far][2] = (at[1].u[i] - at[0].u[i]) * right;
              ends[far][3] = (at[1].v[i] - at[0].v[i]) * right;
              ends[far][4] = (at[2].u[i] - at[0].u[i]) * down;
              ends[far][5] = (at[2].v[i] - at[0].v[i]) * down;
            }
            for (int q = 0; q < 6; ++q) {
              path.at[q][i] =
                  active[i] ? ends[0][q] : std::numeric_limits<float>::quiet_NaN();
              path.by[q][i] = (ends[1][q] - ends[0][q]) * per_log;
            }
            const float moves = std::hypot(path.by[0][i], path.by[1][i]);
            if (moves > slope[i]) slope[i] = moves;
          }
        }
        std::array<float, kPointBatch> step;
        for (int i = 0; i < whole; ++i) step[i] = kStep / std::max(slope[i], kLeastSlope);
        WindowScores total;
        for (auto& row : total.of) std::fill_n(row, whole, 0.0F);
        for (std::size_t k = 0; k < others.size(); ++k) {
          for (auto& row : paths[k].by) {
            for (int i = 0; i < whole; ++i) row[i] *= step[i];
          }
          HWY_DYNAMIC_DISPATCH(Correlate)
          (whole, own.At(x0, y), own.stride, packed[k], paths[k], &scores);
          for (int i = 0; i < whole; ++i) {
            float best = -1.0F;
            bool all = true;
            for (const auto& row : scores.of) {
              all = all && row[i] == row[i];
              best = std::max(best, row[i]);
            }
            if (!all || !(best > kAlike)) continue;
            for (int t = 0; t < kWindowTries; ++t) total.of[t][i] += scores.of[t][i];
          }
        }
        for (int i = 0; i < count; ++i) {
          int best = 0;
          for (int t = 1; t < kWindowTries; ++t) {
            if (total.of[t][i] > total.of[best][i]) best = t;
          }
          if (best == 0 || best == kWindowTries - 1) continue;
          const float before = total.of[best - 1][i], after = total.of[best + 1][i];
          const float curve = before - 2.0F * total.of[best][i] + after;
          if (!(curve < -kSharp)) continue;
          const float part = 0.5F * (before - after) / curve;
          const float by = (static_cast<float>(best - kWindowTries / 2) + part) * step[i];
          const std::size_t at = static_cast<std::size_t>(y) * width + x0 + i;
          depth[at] *= std::exp(by);
          moved[at] = 1;
        }
      }
    }
  });
}

}  // namespace gsut
#endif  // HWY_ONCE
