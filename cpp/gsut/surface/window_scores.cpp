// Vector lanes are neighbouring pixels of a row, so that each sees its own window and the order of
// its sums is fixed. All 49 places of a window are looked up anew at each distance: with a step to
// the right and one down of its own each window samples a plane, which sums over boxes, as the
// sweep's, cannot.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/surface/window_scores.cpp"
#include "gsut/base/hwy_targets.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <cstdint>
#include <limits>

#include "gsut/surface/window_scores.h"

#ifndef GSUT_SURFACE_WINDOW_SCORES
#define GSUT_SURFACE_WINDOW_SCORES
namespace gsut {

constexpr int kLevels = 0x7FFF;            // of a grey value of 15 bits
constexpr std::uint32_t kShown = 0x8000U;  // the bit above: it may be looked at
constexpr float kCount = (2 * kWindowHalf + 1) * (2 * kWindowHalf + 1);

}  // namespace gsut
#endif

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

constexpr float kNoise = 1e-5F;  // variance of noise, squared grey values

using Floats = hn::ScalableTag<float>;
using Vector = hn::Vec<Floats>;
using Mask = hn::Mask<Floats>;

// The windows of one vector of pixels. They are taken about the pixel's own value, as the
// neighbour's are, so that float sums keep their digits.
class Windows {
 public:
  Windows(const float* own, std::int64_t stride) : own_(own), stride_(stride) {
    Vector sum = hn::Zero(f_), squares = hn::Zero(f_);
    middle_ = hn::LoadU(f_, own);
    for (int dy = -kWindowHalf; dy <= kWindowHalf; ++dy) {
      for (int dx = -kWindowHalf; dx <= kWindowHalf; ++dx) {
        const Vector mine = Own(dx, dy);
        sum = hn::Add(sum, mine);
        squares = hn::MulAdd(mine, mine, squares);
      }
    }
    mean_ = hn::Mul(sum, share_);
    variance_ = hn::Sub(hn::Mul(squares, share_), hn::Mul(mean_, mean_));
  }

  // False at borders and where a pixel is masked.
  Mask AreWhole() const { return hn::Eq(variance_, variance_); }

  // Correlations with a neighbour; NaN where it does not show a window. path: as WindowPaths, at
  // one distance. in: windows that lie inside; of the others places are the first pixel, so that
  // gathers stay inside.
  Vector Correlate(const PackedGrey& other, const Vector* path, Mask in) const {
    const hn::RebindToSigned<Floats> n;
    const auto low = hn::Set(n, kLevels), width = hn::Set(n, other.width);
    const auto seen = hn::Set(n, static_cast<std::int32_t>(kShown << 16 | kShown));
    const Vector half = hn::Set(f_, 0.5F), level = hn::Set(f_, 1.0F / static_cast<float>(kLevels));
    Vector sum = hn::Zero(f_), squares = hn::Zero(f_), both = hn::Zero(f_);
    auto shown = seen;  // of a masked pixel the upper bit of its half is 0, and stays so
    for (int dy = -kWindowHalf; dy <= kWindowHalf; ++dy) {
      const Vector down = hn::Set(f_, static_cast<float>(dy));
      const Vector row_u =
          hn::Sub(hn::MulAdd(down, path[WindowPaths::kDownU], path[WindowPaths::kU]), half);
      const Vector row_v =
          hn::Sub(hn::MulAdd(down, path[WindowPaths::kDownV], path[WindowPaths::kV]), half);
      for (int dx = -kWindowHalf; dx <= kWindowHalf; ++dx) {
        const Vector right = hn::Set(f_, static_cast<float>(dx));
        const Vector x =
            hn::IfThenElseZero(in, hn::MulAdd(right, path[WindowPaths::kRightU], row_u));
        const Vector y =
            hn::IfThenElseZero(in, hn::MulAdd(right, path[WindowPaths::kRightV], row_v));
        const auto left = hn::ConvertTo(n, x), top = hn::ConvertTo(n, y);
        const Vector s = hn::Sub(x, hn::ConvertTo(f_, left));
        const Vector t = hn::Sub(y, hn::ConvertTo(f_, top));
        const auto place = hn::Add(hn::Mul(top, width), left);
        // The four pixels about the place.
        const auto above = hn::GatherIndex(n, other.pairs.data(), place);
        const auto below = hn::GatherIndex(n, other.pairs.data() + other.width, place);
        shown = hn::And(shown, hn::And(above, below));
        // The lower half of a pair is the left pixel.
        const auto between = [&](auto pair) {
          const Vector first = hn::ConvertTo(f_, hn::And(pair, low));
          const Vector second = hn::ConvertTo(f_, hn::And(hn::ShiftRight<16>(pair), low));
          return hn::MulAdd(s, hn::Sub(second, first), first);
        };
        const Vector upper = between(above);
        const Vector grey = hn::MulAdd(t, hn::Sub(between(below), upper), upper);
        const Vector theirs = hn::MulSub(grey, level, middle_);
        sum = hn::Add(sum, theirs);
        squares = hn::MulAdd(theirs, theirs, squares);
        both = hn::MulAdd(Own(dx, dy), theirs, both);
      }
    }
    // Noise in both variances: windows of little contrast correlate less.
    const Vector mean = hn::Mul(sum, share_), noise = hn::Set(f_, kNoise);
    const Vector variance = hn::Sub(hn::Mul(squares, share_), hn::Mul(mean, mean));
    const Vector together = hn::Sub(hn::Mul(both, share_), hn::Mul(mean_, mean));
    const Vector product = hn::Mul(hn::Add(variance_, noise), hn::Add(variance, noise));
    const Mask whole = hn::And(in, hn::RebindMask(f_, hn::Eq(shown, seen)));
    return hn::IfThenElse(whole, hn::Div(together, hn::Sqrt(product)), Nothing());
  }

  // What later fails all comparisons: such a neighbour has no say.
  static Vector Nothing() { return hn::Set(Floats(), std::numeric_limits<float>::quiet_NaN()); }

 private:
  Vector Own(int dx, int dy) const {
    return hn::Sub(hn::LoadU(f_, own_ + dy * stride_ + dx), middle_);
  }

  Floats f_;
  const float* own_;
  std::int64_t stride_;
  Vector share_ = hn::Set(f_, 1.0F / kCount);
  Vector middle_;           // of each pixel its own value
  Vector mean_, variance_;  // of its window, about that
};

// Windows whose corners lie between the centres of the neighbour's first and last pixels.
Mask FindInside(const PackedGrey& other, const Vector* path) {
  const Floats f;
  const auto is_inside = [&](Vector middle, Vector right, Vector down, int size) {
    const Vector reach = hn::Mul(hn::Set(f, static_cast<float>(kWindowHalf)),
                                 hn::Add(hn::Abs(right), hn::Abs(down)));
    const Vector last = hn::Set(f, static_cast<float>(size) - 1.0F);
    return hn::And(hn::Ge(hn::Sub(middle, reach), hn::Set(f, 1.0F)),
                   hn::Le(hn::Add(middle, reach), last));
  };
  return hn::And(is_inside(path[WindowPaths::kU], path[WindowPaths::kRightU],
                           path[WindowPaths::kDownU], other.width),
                 is_inside(path[WindowPaths::kV], path[WindowPaths::kRightV],
                           path[WindowPaths::kDownV], other.height));
}

}  // namespace

// As CorrelateWindows; own: the first pixel's place in a padded photograph of `stride` floats a
// row.
void Correlate(const float* own, std::int64_t stride, int count, const PackedGrey& other,
               const WindowPaths& paths, WindowScores* scores) {
  const Floats f;
  for (int i = 0; i < count; i += static_cast<int>(hn::Lanes(f))) {
    const Windows windows(own + i, stride);
    const Mask whole = windows.AreWhole();
    for (int k = 0; k < kWindowTries; ++k) {
      const Vector step = hn::Set(f, static_cast<float>(k - kWindowTries / 2));
      Vector path[WindowPaths::kNumbers];
      for (int q = 0; q < WindowPaths::kNumbers; ++q) {
        path[q] = hn::MulAdd(step, hn::Load(f, paths.by[q] + i), hn::Load(f, paths.at[q] + i));
      }
      const Mask in = hn::And(whole, FindInside(other, path));
      const Vector score =
          hn::AllFalse(f, in) ? Windows::Nothing() : windows.Correlate(other, path, in);
      hn::Store(score, f, scores->of[k] + i);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {

HWY_EXPORT(Correlate);

PackedGrey::PackedGrey(const float* grey, int w, int h)
    : width(w), height(h), pairs(static_cast<std::size_t>(w) * h) {
  const auto bits = [&](int x, int y) -> std::uint32_t {
    const float value = grey[static_cast<std::size_t>(y) * width + std::min(x, width - 1)];
    if (!(value >= 0.0F)) return 0;  // NaN
    // Rounded to a 32767th, a hundredth of what photographs of 8 bits are rounded to.
    const float level = std::min(value, 1.0F) * static_cast<float>(kLevels);
    return kShown | static_cast<std::uint32_t>(level + 0.5F);
  };
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      pairs[static_cast<std::size_t>(y) * width + x] =
          static_cast<std::int32_t>(bits(x, y) | bits(x + 1, y) << 16);
    }
  }
}

PaddedGrey::PaddedGrey(const float* grey, int width, int height)
    : stride_(width + 2 * kWindowHalf + kPointBatch),
      values_(static_cast<std::size_t>(stride_) * (height + 2 * kWindowHalf),
              std::numeric_limits<float>::quiet_NaN()) {
  for (int y = 0; y < height; ++y) {
    std::copy_n(grey + static_cast<std::size_t>(y) * width, width, &values_[Index(0, y)]);
  }
}

bool PaddedGrey::IsTextured(int x, int y) const {
  constexpr float kContrast = 0.008F;  // standard deviation below which a window is plain
  const float* at = At(x, y);
  float sum = 0.0F, squares = 0.0F;
  for (int dy = -kWindowHalf; dy <= kWindowHalf; ++dy) {
    for (int dx = -kWindowHalf; dx <= kWindowHalf; ++dx) {
      const float off = at[dy * stride_ + dx] - at[0];
      sum += off;
      squares += off * off;
    }
  }
  return squares / kCount - sum / kCount * (sum / kCount) > kContrast * kContrast;
}

void CorrelateWindows(const PaddedGrey& own, int x, int y, int count, const PackedGrey& other,
                      const WindowPaths& paths, WindowScores* scores) {
  HWY_DYNAMIC_DISPATCH(Correlate)(own.At(x, y), own.stride(), count, other, paths, scores);
}

}  // namespace gsut
#endif  // HWY_ONCE
