// Vector kernels of the photometric loss: L1, SSIM and their gradient over one block, line by line.
//
// With d = image - target, means m and variances v in the (renormalised) window,
//   P = m_x^2 + m_y^2 + C1,  Q = v_x + v_y + C2,  a = m_d^2 / P,  b = v_d / Q,
// SSIM = (1 - a) (1 - b) exactly, because 2 m_x m_y = m_x^2 + m_y^2 - m_d^2 and
// 2 cov_xy = v_x + v_y - v_d. So 1 - SSIM = a + b - a b is formed from the difference image and
// keeps its digits in float as the images become equal. Derivatives of 1 - SSIM to the window sums:
//   to E[d^2]:  (1 - a) / Q
//   to E[x^2]: -(1 - a) b / Q
//   to E[x]:    2 (1 - b) (m_d - a m_x) / P + 2 (1 - a) (b m_x - m_d) / Q
// Each, times the window's scale, is blurred once more (the window is symmetric) and gathered:
//   dsum/dx = mask (B[E[x]] + 2 d B[E[d^2]] + 2 x B[E[x^2]]).
// Variances do not see a shift, so images are centred (minus 0.5) before they are squared.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/loss/photometric_kernel.cpp"
#include "gsut/base/hwy_targets.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/loss/photometric_kernel.h"
#include "gsut/loss/photometric_lines-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

// Quantities in the ring of blurred signals. The target's come first, where they are computed.
enum TargetSignal { kTargetMean, kTargetSquare, kTargetSignals };
enum ImageSignal { kDifferenceMean, kDifferenceSquare, kImageSquare, kImageSignals };

HWY_INLINE void BlurTarget(const Weights& weights, const float* target, float* out) {
  VF mean, square;
  BlurSquare<true>(weights, target, mean, square);
  hn::Store(mean, DF(), out + kTargetMean * Lanes());
  hn::Store(square, DF(), out + kTargetSquare * Lanes());
}

// Mean and variance of the target from the ring; scale: of the window.
HWY_INLINE void TargetMoments(const Weights& weights, const float* const* rows, std::int64_t at,
                              VF scale, VF& mean, VF& variance) {
  mean = hn::Mul(scale, BlurColumn(weights, rows, at + kTargetMean * Lanes()));
  const VF square = hn::Mul(scale, BlurColumn(weights, rows, at + kTargetSquare * Lanes()));
  variance = hn::NegMulAdd(mean, mean, square);
}

// The loss of one block. Three rows move down together: the input row is loaded and blurred along
// itself, SSIM is formed 5 rows above it, the gradient 10 rows above it.
// kComputeTarget: the target's statistics are computed here, not read.
template <bool kComputeTarget>
class BlockLoss {
 public:
  BlockLoss(const PhotometricTarget& target, const float* image, const ImageBlock& block,
            float l1_factor, float dssim_factor, float* gradient, AlignedVector<float>& memory)
      : target_(target),
        image_(image),
        block_(block),
        l1_factor_(l1_factor),
        dssim_factor_(dssim_factor),
        gradient_(gradient),
        reach_(gradient == nullptr ? kSsimRadius : kMargin),
        first_(block.row_begin - reach_),
        lines_(memory, block, target.width(), kSignals) {
    PrepareLines(target, lines_);
  }

  BlockSums Run() {
    for (std::int64_t input = first_; input < block_.row_end + reach_; ++input) {
      BlurInputRow(input);
      const std::int64_t middle = input - kSsimRadius;
      if (middle < first_ + kSsimRadius) continue;
      FormSsimRow(middle);
      const std::int64_t output = middle - kSsimRadius;
      if (gradient_ != nullptr && output >= block_.row_begin) WriteGradientRow(output);
    }
    return sums_;
  }

 private:
  static constexpr int kFirst = kComputeTarget ? kTargetSignals : 0;
  static constexpr int kSignals = kFirst + kImageSignals;

  bool OutsideImage(std::int64_t row) const { return row < 0 || row >= target_.height(); }
  bool InBlock(std::int64_t row) const { return row >= block_.row_begin && row < block_.row_end; }

  // Reads a row of both images and blurs d, d^2 and x^2 (and y, y^2) along it.
  void BlurInputRow(std::int64_t row) {
    const std::int64_t n = Lanes();
    float* const signals = lines_.BlurredSignals(row - first_);
    if (OutsideImage(row)) {
      std::fill_n(signals, kSignals * (lines_.length + n), 0.0f);
      return;
    }
    float* const target = lines_.Line(Lines::kTarget);
    float* const mask = lines_.Mask(row - first_);
    float* const image = lines_.Image(row - first_);
    float* const difference = lines_.Difference(row - first_);
    LoadTargetRow(target_, lines_, row, target);
    float* const plain = kComputeTarget ? lines_.Line(Lines::kPlain) : nullptr;
    // Statistics are those of the photograph without its gain, as kept ones are: the same bits.
    if (kComputeTarget) std::copy_n(target, lines_.length, plain);
    if (target_.has_gain()) MultiplyLine(lines_, lines_.Line(Lines::kGain), target);
    LoadMaskRow(target_, lines_, row, mask);
    CentreImage(lines_, image_ + (row * target_.width() + lines_.inside_begin) * kChannels, mask,
                target, image, difference);
    if (kComputeTarget) CentreTarget(lines_, mask, plain);
    if (InBlock(row)) sums_.absolute += SumLine<true>(difference, lines_.core, lines_.core_end);
    const DF d;
    const Weights weights;
    for (std::int64_t i = 0; i < lines_.length; i += n) {
      float* const out = signals + i * kSignals;
      if (kComputeTarget) BlurTarget(weights, plain + i, out);
      VF mean, square, unused;
      BlurSquare<true>(weights, difference + i, mean, square);
      hn::Store(mean, d, out + (kFirst + kDifferenceMean) * n);
      hn::Store(square, d, out + (kFirst + kDifferenceSquare) * n);
      BlurSquare<false>(weights, image + i, unused, square);
      hn::Store(square, d, out + (kFirst + kImageSquare) * n);
    }
  }

  // Blurs down the columns, forms 1 - SSIM and its derivatives to the window sums, and blurs these
  // along the row.
  void FormSsimRow(std::int64_t row) {
    const DF d;
    const Weights weights;
    const std::int64_t n = Lanes();
    float* const blurred = lines_.BlurredCoefficients(row - first_);
    if (OutsideImage(row)) {
      std::fill_n(blurred, Lines::kCoefficients * (lines_.length + n), 0.0f);
      return;
    }
    const VF row_scale = hn::Set(d, LoadScaleRow(target_, lines_, row));
    const float* const scales = lines_.Line(Lines::kScale);
    // The margins may reach into the padding: nothing is averaged there.
    static_assert(PhotometricTarget::kStatisticsPadding >=
                  kMargin * kChannels + HWY_MAX_BYTES / sizeof(float));
    const std::int64_t plane_at =
        (row * target_.width() + block_.column_begin - kMargin) * kChannels;
    const float* const gains = target_.has_gain() ? lines_.Line(Lines::kGain) : nullptr;
    float* const dssims = lines_.Line(Lines::kDssim);
    float* const coefficients[Lines::kCoefficients] = {lines_.Line(Lines::kCoefficient0),
                                                       lines_.Line(Lines::kCoefficient0 + 1),
                                                       lines_.Line(Lines::kCoefficient0 + 2)};
    // The 11 rows around this one, top to bottom, wherever the ring holds them.
    const float* rows[kRing];
    for (std::int64_t t = 0; t < kRing; ++t) {
      rows[t] = lines_.BlurredSignals(row - first_ - kSsimRadius + t);
    }
    const VF zero = hn::Zero(d), one = hn::Set(d, 1.0f), two = hn::Set(d, 2.0f);
    const VF centre = hn::Set(d, kCentre);
    const VF c1 = hn::Set(d, static_cast<float>(kSsimC1));
    const VF c2 = hn::Set(d, static_cast<float>(kSsimC2));
    for (std::int64_t i = 0; i < lines_.length; i += n) {
      const std::int64_t at = i * kSignals;
      const VF scale = hn::Mul(row_scale, hn::Load(d, scales + i));
      VF mean_y, variance_y;
      if (kComputeTarget) {
        TargetMoments(weights, rows, at, scale, mean_y, variance_y);
      } else {
        mean_y = hn::LoadU(d, target_.mean() + plane_at + i);
        variance_y = hn::LoadU(d, target_.variance() + plane_at + i);
      }
      if (gains != nullptr) ApplyGainToMoments(gains + i, mean_y, variance_y);
      const std::int64_t image_at = at + kFirst * n;
      const VF mean_d = hn::Mul(scale, BlurColumn(weights, rows, image_at + kDifferenceMean * n));
      const VF square_d =
          hn::Mul(scale, BlurColumn(weights, rows, image_at + kDifferenceSquare * n));
      const VF square_x = hn::Mul(scale, BlurColumn(weights, rows, image_at + kImageSquare * n));
      const VF mean_x = hn::Add(mean_y, mean_d);  // centred, like mean_y
      const VF variance_d = hn::NegMulAdd(mean_d, mean_d, square_d);
      const VF variance_x = hn::NegMulAdd(mean_x, mean_x, square_x);
      const VF full_x = hn::Add(mean_x, centre);
      const VF full_y = hn::Add(mean_y, centre);
      const VF p = hn::MulAdd(full_x, full_x, hn::MulAdd(full_y, full_y, c1));
      const VF q = hn::Add(hn::Add(variance_x, variance_y), c2);
      const VF inverse_p = hn::Div(one, p);
      const VF inverse_q = hn::Div(one, q);
      // m_d^2 / P and v_d / Q: what luminance and structure lack of agreement.
      const VF a = hn::Mul(hn::Mul(mean_d, mean_d), inverse_p);
      const VF b = hn::Mul(variance_d, inverse_q);
      const auto averaged = hn::Gt(scale, zero);
      const VF dssim = hn::NegMulAdd(a, b, hn::Add(a, b));
      hn::Store(hn::IfThenElseZero(averaged, dssim), d, dssims + i);
      // P sees the full mean, the variances in Q the centred one.
      const VF to_square_d = hn::Mul(scale, hn::Mul(hn::Sub(one, a), inverse_q));
      const VF to_square_x = hn::Neg(hn::Mul(b, to_square_d));
      const VF from_p = hn::Mul(hn::Mul(scale, hn::Mul(hn::Sub(one, b), inverse_p)),
                                hn::NegMulAdd(a, full_x, mean_d));
      const VF from_q = hn::Mul(to_square_d, hn::MulSub(b, mean_x, mean_d));
      const VF to_mean = hn::Mul(two, hn::Add(from_p, from_q));
      hn::Store(hn::IfThenElseZero(averaged, to_mean), d, coefficients[0] + i);
      hn::Store(hn::IfThenElseZero(averaged, to_square_d), d, coefficients[1] + i);
      hn::Store(hn::IfThenElseZero(averaged, to_square_x), d, coefficients[2] + i);
    }
    // Rows of the margin serve the gradient alone: the block that owns them counts their loss.
    if (InBlock(row)) sums_.dssim += SumLine<false>(dssims, lines_.core, lines_.core_end);
    if (gradient_ == nullptr) return;
    for (std::int64_t i = 0; i < lines_.length; i += n) {
      for (int c = 0; c < Lines::kCoefficients; ++c) {
        hn::Store(BlurLine(weights, coefficients[c] + i), d,
                  blurred + i * Lines::kCoefficients + c * n);
      }
    }
  }

  // The last formula above, a row at a time: coefficients blurred down the columns, times the
  // image's and the difference's own values. L1's gradient is the sign of d, 0 where they agree.
  void WriteGradientRow(std::int64_t row) {
    const DF d;
    const Weights weights;
    const std::int64_t n = Lanes();
    const float* const mask = lines_.Mask(row - first_);
    const float* const image = lines_.Image(row - first_);
    const float* const differences = lines_.Difference(row - first_);
    float* const out = lines_.Line(Lines::kGradient);
    const float* rows[kRing];
    for (std::int64_t t = 0; t < kRing; ++t) {
      rows[t] = lines_.BlurredCoefficients(row - first_ - kSsimRadius + t);
    }
    const VF zero = hn::Zero(d), two = hn::Set(d, 2.0f);
    const VF l1_factor = hn::Set(d, l1_factor_), dssim_factor = hn::Set(d, dssim_factor_);
    for (std::int64_t i = lines_.core / n * n; i < lines_.core_end; i += n) {
      const std::int64_t at = i * Lines::kCoefficients;
      const VF to_mean = BlurColumn(weights, rows, at);
      const VF to_square_d = BlurColumn(weights, rows, at + n);
      const VF to_square_x = BlurColumn(weights, rows, at + 2 * n);
      const VF difference = hn::Load(d, differences + i);
      const VF half =
          hn::MulAdd(difference, to_square_d, hn::Mul(hn::Load(d, image + i), to_square_x));
      const VF from_ssim = hn::Mul(dssim_factor, hn::MulAdd(two, half, to_mean));
      const VF from_l1 =
          hn::IfThenElseZero(hn::Ne(difference, zero), hn::CopySign(l1_factor, difference));
      const auto counts = hn::Gt(hn::Load(d, mask + i), zero);
      hn::Store(hn::IfThenElseZero(counts, hn::Add(from_l1, from_ssim)), d, out + i);
    }
    std::memcpy(gradient_ + (row * target_.width() + block_.column_begin) * kChannels,
                out + lines_.core, lines_.CoreBytes());
  }

  const PhotometricTarget& target_;
  const float* image_;
  const ImageBlock block_;
  const float l1_factor_, dssim_factor_;
  float* const gradient_;
  const std::int64_t reach_;  // rows beyond the block that are read
  const std::int64_t first_;  // the first row read; the rings count from here
  const Lines lines_;
  BlockSums sums_;
};

BlockSums PhotometricBlockKernel(const PhotometricTarget& target, const float* image,
                                 const ImageBlock& block, float l1_factor, float dssim_factor,
                                 float* gradient, AlignedVector<float>& memory) {
  if (target.mean() == nullptr) {
    return BlockLoss<true>(target, image, block, l1_factor, dssim_factor, gradient, memory).Run();
  }
  return BlockLoss<false>(target, image, block, l1_factor, dssim_factor, gradient, memory).Run();
}

// The same two blurs for the photograph alone; the ring of 11 rows moves down, and each row written
// is 5 above the one read.
void TargetStatisticsKernel(const PhotometricTarget& target, const ImageBlock& block, float* mean,
                            float* variance, AlignedVector<float>& memory) {
  const DF d;
  const Weights weights;
  const std::int64_t n = Lanes();
  const Lines lines(memory, block, target.width(), kTargetSignals);
  PrepareLines(target, lines);
  float* const target_line = lines.Line(Lines::kTarget);
  float* const mean_line = lines.Line(Lines::kMean);
  float* const variance_line = lines.Line(Lines::kVariance);
  const float* const scales = lines.Line(Lines::kScale);
  const std::int64_t first = block.row_begin - kSsimRadius;
  for (std::int64_t input = first; input < block.row_end + kSsimRadius; ++input) {
    float* const signals = lines.BlurredSignals(input - first);
    if (input < 0 || input >= target.height()) {
      std::fill_n(signals, kTargetSignals * (lines.length + n), 0.0f);
    } else {
      float* const mask_line = lines.Mask(input - first);
      LoadTargetRow(target, lines, input, target_line);
      LoadMaskRow(target, lines, input, mask_line);
      CentreTarget(lines, mask_line, target_line);
      for (std::int64_t i = 0; i < lines.length; i += n) {
        BlurTarget(weights, target_line + i, signals + i * kTargetSignals);
      }
    }
    const std::int64_t output = input - kSsimRadius;
    if (output < block.row_begin) continue;
    const VF row_scale = hn::Set(d, LoadScaleRow(target, lines, output));
    const float* rows[kRing];
    for (std::int64_t t = 0; t < kRing; ++t) {
      rows[t] = lines.BlurredSignals(output - first - kSsimRadius + t);
    }
    for (std::int64_t i = 0; i < lines.length; i += n) {
      VF m, v;
      const VF scale = hn::Mul(row_scale, hn::Load(d, scales + i));
      TargetMoments(weights, rows, i * kTargetSignals, scale, m, v);
      hn::Store(m, d, mean_line + i);
      hn::Store(v, d, variance_line + i);
    }
    const std::int64_t at = (output * target.width() + block.column_begin) * kChannels;
    std::memcpy(mean + at, mean_line + lines.core, lines.CoreBytes());
    std::memcpy(variance + at, variance_line + lines.core, lines.CoreBytes());
  }
}

}  // namespace
// NOLINTNEXTLINE(google-readability-namespace-comments)
}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
namespace {

HWY_EXPORT(PhotometricBlockKernel);
HWY_EXPORT(TargetStatisticsKernel);

// Line buffers of this thread, kept between calls.
AlignedVector<float>& ThreadLines() {
  thread_local AlignedVector<float> memory;
  return memory;
}

}  // namespace

BlockSums PhotometricBlock(const PhotometricTarget& target, const float* image,
                           const ImageBlock& block, float l1_factor, float dssim_factor,
                           float* gradient) {
  return HWY_DYNAMIC_DISPATCH(PhotometricBlockKernel)(target, image, block, l1_factor, dssim_factor,
                                                      gradient, ThreadLines());
}

void TargetStatisticsBlock(const PhotometricTarget& target, const ImageBlock& block, float* mean,
                           float* variance) {
  HWY_DYNAMIC_DISPATCH(TargetStatisticsKernel)(target, block, mean, variance, ThreadLines());
}

}  // namespace gsut
#endif  // HWY_ONCE
