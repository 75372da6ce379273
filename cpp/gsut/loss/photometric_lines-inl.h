// Line buffers and blurs of the photometric kernels, compiled once per instruction set.
//
// Lines keep the three channels interleaved: a tap to the next pixel is 3 floats away, and nothing
// is taken apart or put together. A line holds the block's columns and a margin of 10 on each side.

#if defined(GSUT_LOSS_PHOTOMETRIC_LINES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_LOSS_PHOTOMETRIC_LINES_INL_H_
#undef GSUT_LOSS_PHOTOMETRIC_LINES_INL_H_
#else
#define GSUT_LOSS_PHOTOMETRIC_LINES_INL_H_
#endif

#include <hwy/highway.h>

#include <algorithm>
#include <cstring>

#include "gsut/base/aligned_vector.h"
#include "gsut/loss/photometric.h"
#include "gsut/loss/photometric_kernel.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using DF = hn::ScalableTag<float>;
using VF = hn::Vec<DF>;

constexpr int kChannels = 3;
constexpr std::int64_t kMargin = 2 * kSsimRadius;  // pixels; two blurs
constexpr std::int64_t kTap = kChannels;           // floats between neighbouring pixels
constexpr std::int64_t kPad = 16;                  // floats, >= kSsimRadius * kTap
constexpr std::int64_t kRing = kSsimWindow;        // lines a vertical blur needs
constexpr float kCentre = 0.5f;                    // subtracted before squaring
constexpr float kByteScale = 1.0f / 255.0f;

HWY_INLINE std::int64_t Lanes() { return static_cast<std::int64_t>(hn::Lanes(DF())); }

struct Weights {
  VF w[kSsimRadius + 1];  // from the centre outwards
  Weights() {
    for (int t = 0; t <= kSsimRadius; ++t) {
      w[t] = hn::Set(DF(),
                     static_cast<float>(SsimWeights()[static_cast<std::size_t>(kSsimRadius + t)]));
    }
  }
};

// Memory of a block: rings of the 11 lines that a vertical blur reads, for what is needed again
// further down (image, difference, mask, blurred signals and coefficients), and single lines.
// Geometry and line buffers of one block.
class Lines {
 public:
  Lines(AlignedVector<float>& memory, const ImageBlock& block, std::int64_t width, int sums)
      : columns(block.column_end - block.column_begin),
        length((columns + 2 * kMargin) * kChannels),
        core(kMargin * kChannels),
        core_end(core + columns * kChannels),
        inside_begin(std::max<std::int64_t>(0, block.column_begin - kMargin)),
        inside_count(std::min(width, block.column_end + kMargin) - inside_begin),
        inside((inside_begin - (block.column_begin - kMargin)) * kChannels),
        stride_((length + 3 * kPad - 1) / kPad * kPad) {
    const std::int64_t lines = 3 * kRing + kSingles + (sums + kCoefficients) * kRing;
    const auto needed = static_cast<std::size_t>(lines * stride_);
    if (memory.size() < needed) memory.assign(needed, 0.0f);
    base_ = memory.data() + kPad;
    blurred_signals_ = memory.data() + (3 * kRing + kSingles) * stride_;
    blurred_coefficients_ = blurred_signals_ + sums * kRing * stride_;
    signal_stride_ = sums * stride_;
  }

  // Plain lines, kPad floats before and after each. Row counts from the block's first input row.
  float* Difference(std::int64_t row) const { return base_ + (row % kRing) * stride_; }
  float* Image(std::int64_t row) const { return base_ + (kRing + row % kRing) * stride_; }
  float* Mask(std::int64_t row) const { return base_ + (2 * kRing + row % kRing) * stride_; }
  enum Single {
    kTarget,
    kScale,
    kMean,
    kVariance,
    kDssim,
    kGradient,
    kGain,
    kLight,
    kPlain,  // the photograph without its gain
    kCoefficient0
  };
  float* Line(int single) const { return base_ + (3 * kRing + single) * stride_; }
  // Horizontally blurred lines: vectors of the quantities take turns.
  float* BlurredSignals(std::int64_t row) const {
    return blurred_signals_ + (row % kRing) * signal_stride_;
  }
  float* BlurredCoefficients(std::int64_t row) const {
    return blurred_coefficients_ + (row % kRing) * (kCoefficients * stride_);
  }

  std::size_t CoreBytes() const {
    return static_cast<std::size_t>(core_end - core) * sizeof(float);
  }

  static constexpr int kCoefficients = 3;
  static constexpr int kSingles = kCoefficient0 + kCoefficients;
  std::int64_t columns;       // of the block
  std::int64_t length;        // floats in a line, with margins
  std::int64_t core;          // first float of the block's own columns
  std::int64_t core_end;      // past the last
  std::int64_t inside_begin;  // first image column in the line
  std::int64_t inside_count;  // image columns in the line
  std::int64_t inside;        // first float that lies in the image

 private:
  std::int64_t stride_, signal_stride_;
  float* base_;
  float* blurred_signals_;
  float* blurred_coefficients_;
};

// Copies the block's columns of an (H, W, 3) plane's row into a line.
HWY_INLINE void CopyRow(const Lines& lines, const float* plane, std::int64_t width,
                        std::int64_t row, float* line) {
  std::memcpy(line + lines.inside, plane + (row * width + lines.inside_begin) * kChannels,
              static_cast<std::size_t>(lines.inside_count * kChannels) * sizeof(float));
}

void LoadPhotographRow(const PhotometricTarget& target, const Lines& lines, std::int64_t row,
                       float* line) {
  if (target.byte_image() == nullptr) {
    CopyRow(lines, target.float_image(), target.width(), row, line);
    return;
  }
  const std::uint8_t* bytes =
      target.byte_image() + (row * target.width() + lines.inside_begin) * kChannels;
  const DF d;
  const hn::Rebind<std::int32_t, DF> di;
  const hn::Rebind<std::uint8_t, DF> du;
  const std::int64_t count = lines.inside_count * kChannels;
  std::int64_t i = 0;
  for (; i + Lanes() <= count; i += Lanes()) {
    const VF value = hn::ConvertTo(d, hn::PromoteTo(di, hn::LoadU(du, bytes + i)));
    hn::StoreU(hn::Mul(value, hn::Set(d, kByteScale)), d, line + lines.inside + i);
  }
  for (; i < count; ++i) line[lines.inside + i] = static_cast<float>(bytes[i]) * kByteScale;
}

// Repeats each value of a row three times, once a channel. Outside the image the line is 0.
HWY_INLINE void ExpandFloats(const float* values, std::int64_t count, float* line) {
  const DF d;
  std::int64_t i = 0;
  for (; i + Lanes() <= count; i += Lanes()) {
    const VF value = hn::LoadU(d, values + i);
    hn::StoreInterleaved3(value, value, value, d, line + i * kChannels);
  }
  for (; i < count; ++i) {
    for (int c = 0; c < kChannels; ++c) line[i * kChannels + c] = values[i];
  }
}

HWY_INLINE void ExpandMask(const std::uint8_t* mask, std::int64_t count, float* line) {
  const DF d;
  const hn::Rebind<std::int32_t, DF> di;
  const hn::Rebind<std::uint8_t, DF> du;
  std::int64_t i = 0;
  for (; i + Lanes() <= count; i += Lanes()) {
    const VF value = hn::ConvertTo(d, hn::PromoteTo(di, hn::LoadU(du, mask + i)));
    hn::StoreInterleaved3(value, value, value, d, line + i * kChannels);
  }
  for (; i < count; ++i) {
    for (int c = 0; c < kChannels; ++c) line[i * kChannels + c] = static_cast<float>(mask[i]);
  }
}

// line *= factors, in the whole line.
HWY_INLINE void MultiplyLine(const Lines& lines, const float* HWY_RESTRICT factors,
                             float* HWY_RESTRICT line) {
  const DF d;
  for (std::int64_t i = 0; i < lines.length; i += Lanes()) {
    hn::Store(hn::Mul(hn::Load(d, line + i), hn::Load(d, factors + i)), d, line + i);
  }
}

// A row of the photograph, each pixel over its falloff.
void LoadTargetRow(const PhotometricTarget& target, const Lines& lines, std::int64_t row,
                   float* line) {
  LoadPhotographRow(target, lines, row, line);
  if (target.inverse_falloff() == nullptr) return;
  float* const light = lines.Line(Lines::kLight);
  CopyRow(lines, target.inverse_falloff(), target.width(), row, light);
  MultiplyLine(lines, light, line);
}

// Mean (minus 0.5) and variance of a photograph become those of the photograph times its gain.
HWY_INLINE void ApplyGainToMoments(const float* gains, VF& mean, VF& variance) {
  const DF d;
  const VF centre = hn::Set(d, kCentre);
  const VF gain = hn::Load(d, gains);
  mean = hn::Sub(hn::Mul(gain, hn::Add(mean, centre)), centre);
  variance = hn::Mul(hn::Mul(gain, gain), variance);
}

// Prepares what stays the same over the block: zeros outside the image, the scale of the columns.
void PrepareLines(const PhotometricTarget& target, const Lines& lines) {
  for (std::int64_t row = 0; row < kRing; ++row) {
    for (float* const line : {lines.Image(row), lines.Difference(row)}) {
      std::fill_n(line - kPad, lines.inside + kPad, 0.0f);
      const std::int64_t end = lines.inside + lines.inside_count * kChannels;
      std::fill_n(line + end, lines.length + kPad - end, 0.0f);
    }
    std::fill_n(lines.Mask(row), lines.length, 0.0f);
    if (target.mask() == nullptr) {
      std::fill_n(lines.Mask(row) + lines.inside, lines.inside_count * kChannels, 1.0f);
    }
  }
  for (std::int64_t i = 0; target.has_gain() && i < lines.length; ++i) {
    lines.Line(Lines::kGain)[i] = target.inverse_gain()[static_cast<std::size_t>(i % kChannels)];
  }
  std::fill_n(lines.Line(Lines::kScale), lines.length, 0.0f);
  if (target.scale_plane() == nullptr) {
    ExpandFloats(target.scale_columns() + lines.inside_begin, lines.inside_count,
                 lines.Line(Lines::kScale) + lines.inside);
  }
}

// Loads the scale of a row; returns a factor that still has to be applied to the line.
float LoadScaleRow(const PhotometricTarget& target, const Lines& lines, std::int64_t row) {
  if (target.scale_plane() == nullptr) return target.scale_rows()[row];
  ExpandFloats(target.scale_plane() + row * target.width() + lines.inside_begin, lines.inside_count,
               lines.Line(Lines::kScale) + lines.inside);
  return 1.0f;
}

void LoadMaskRow(const PhotometricTarget& target, const Lines& lines, std::int64_t row,
                 float* line) {
  if (target.mask() == nullptr) return;
  ExpandMask(target.mask() + row * target.width() + lines.inside_begin, lines.inside_count,
             line + lines.inside);
}

// target -> mask (target - 0.5), in place.
void CentreTarget(const Lines& lines, const float* HWY_RESTRICT mask, float* HWY_RESTRICT target) {
  const DF d;
  const VF centre = hn::Set(d, kCentre);
  for (std::int64_t i = 0; i < lines.length; i += Lanes()) {
    const auto counts = hn::Gt(hn::Load(d, mask + i), hn::Zero(d));
    const VF y = hn::Sub(hn::Load(d, target + i), centre);
    hn::Store(hn::IfThenElseZero(counts, y), d, target + i);
  }
}

// From a row of the image plane: difference = mask (image - target), image = mask (image - 0.5);
// masked values may be NaN. Outside the image both stay as they are, see PrepareLines.
void CentreImage(const Lines& lines, const float* HWY_RESTRICT row, const float* HWY_RESTRICT mask,
                 const float* HWY_RESTRICT target, float* HWY_RESTRICT image,
                 float* HWY_RESTRICT difference) {
  const DF d;
  const VF centre = hn::Set(d, kCentre);
  const std::int64_t count = lines.inside_count * kChannels;
  const auto vector = [&](std::int64_t i) HWY_ATTR {
    const std::int64_t at = lines.inside + i;
    const auto counts = hn::Gt(hn::LoadU(d, mask + at), hn::Zero(d));
    const VF x = hn::LoadU(d, row + i);
    hn::StoreU(hn::IfThenElseZero(counts, hn::Sub(x, hn::LoadU(d, target + at))), d,
               difference + at);
    hn::StoreU(hn::IfThenElseZero(counts, hn::Sub(x, centre)), d, image + at);
  };
  std::int64_t i = 0;
  for (; i + Lanes() <= count; i += Lanes()) vector(i);
  // The rest of a line by one more vector that overlaps the last: it writes the same values twice.
  if (i == count) return;
  if (count >= Lanes()) {
    vector(count - Lanes());
    return;
  }
  for (; i < count; ++i) {
    const std::int64_t at = lines.inside + i;
    const bool counts = mask[at] > 0.0f;
    difference[at] = counts ? row[i] - target[at] : 0.0f;
    image[at] = counts ? row[i] - kCentre : 0.0f;
  }
}

// Sum of a line's floats [begin, end), or of their absolute values.
template <bool kAbsolute>
double SumLine(const float* line, std::int64_t begin, std::int64_t end) {
  const DF d;
  VF sums[2] = {hn::Zero(d), hn::Zero(d)};
  std::int64_t i = begin;
  for (; i + 2 * Lanes() <= end; i += 2 * Lanes()) {
    for (int k = 0; k < 2; ++k) {
      const VF value = hn::LoadU(d, line + i + k * Lanes());
      sums[k] = hn::Add(sums[k], kAbsolute ? hn::Abs(value) : value);
    }
  }
  double sum = static_cast<double>(hn::GetLane(hn::SumOfLanes(d, hn::Add(sums[0], sums[1]))));
  for (; i < end; ++i) {
    sum += static_cast<double>(kAbsolute && line[i] < 0.0f ? -line[i] : line[i]);
  }
  return sum;
}

// The values `pixels` away from those of the vector at p, on either side: loads that cross cache
// lines cost two each, so that wide vectors are shifted together from three aligned ones.
class Neighbours {
 public:
#if HWY_MAX_BYTES == 64
  explicit HWY_INLINE Neighbours(const float* p)
      : before_(hn::Load(DF(), p - 16)), here_(hn::Load(DF(), p)), after_(hn::Load(DF(), p + 16)) {}
  HWY_INLINE VF Here() const { return here_; }
  template <int kPixels>
  HWY_INLINE VF Left() const {
    return FromLane<16 - kPixels * kTap>(before_, here_);
  }
  template <int kPixels>
  HWY_INLINE VF Right() const {
    return FromLane<kPixels * kTap>(here_, after_);
  }

 private:
  template <int kLane>
  static HWY_INLINE VF FromLane(VF low, VF high) {
    return VF{_mm512_castsi512_ps(
        _mm512_alignr_epi32(_mm512_castps_si512(high.raw), _mm512_castps_si512(low.raw), kLane))};
  }
  VF before_, here_, after_;
#else
  explicit HWY_INLINE Neighbours(const float* p) : p_(p) {}
  HWY_INLINE VF Here() const { return hn::LoadU(DF(), p_); }
  template <int kPixels>
  HWY_INLINE VF Left() const {
    return hn::LoadU(DF(), p_ - kPixels * kTap);
  }
  template <int kPixels>
  HWY_INLINE VF Right() const {
    return hn::LoadU(DF(), p_ + kPixels * kTap);
  }

 private:
  const float* p_;
#endif
};

// visit(weight, left, right) for each pair of pixels as far to the left as to the right.
template <class Visit>
HWY_INLINE void ForEachPair(const Weights& weights, const Neighbours& line, Visit&& visit) {
  static_assert(kSsimRadius == 5);
  visit(weights.w[1], line.Left<1>(), line.Right<1>());
  visit(weights.w[2], line.Left<2>(), line.Right<2>());
  visit(weights.w[3], line.Left<3>(), line.Right<3>());
  visit(weights.w[4], line.Left<4>(), line.Right<4>());
  visit(weights.w[5], line.Left<5>(), line.Right<5>());
}

// Horizontal blur of a line p and of its square, vector number i.
template <bool kWithMean>
HWY_INLINE void BlurSquare(const Weights& weights, const float* p, VF& mean, VF& square) {
  const Neighbours line(p);
  const VF centre = line.Here();
  if (kWithMean) mean = hn::Mul(weights.w[0], centre);
  square = hn::Mul(weights.w[0], hn::Mul(centre, centre));
  ForEachPair(weights, line, [&](VF weight, VF left, VF right) HWY_ATTR {
    if (kWithMean) mean = hn::MulAdd(weight, hn::Add(left, right), mean);
    square = hn::MulAdd(weight, hn::MulAdd(left, left, hn::Mul(right, right)), square);
  });
}

HWY_INLINE VF BlurLine(const Weights& weights, const float* p) {
  const Neighbours line(p);
  VF sum = hn::Mul(weights.w[0], line.Here());
  ForEachPair(weights, line, [&](VF weight, VF left, VF right) HWY_ATTR {
    sum = hn::MulAdd(weight, hn::Add(left, right), sum);
  });
  return sum;
}

// Vertical blur at one position of horizontally blurred lines, top to bottom.
HWY_INLINE VF BlurColumn(const Weights& weights, const float* const* rows, std::int64_t at) {
  const DF d;
  VF sum = hn::Mul(weights.w[0], hn::Load(d, rows[kSsimRadius] + at));
  for (int t = 1; t <= kSsimRadius; ++t) {
    const VF pair =
        hn::Add(hn::Load(d, rows[kSsimRadius - t] + at), hn::Load(d, rows[kSsimRadius + t] + at));
    sum = hn::MulAdd(weights.w[t], pair, sum);
  }
  return sum;
}

}  // namespace
// NOLINTNEXTLINE(google-readability-namespace-comments)
}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard per target
