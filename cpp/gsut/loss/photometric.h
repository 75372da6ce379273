// The photometric training loss (1 - w) L1 + w (1 - SSIM) and its gradient to the image.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <shared_mutex>
#include <vector>

#include "gsut/loss/ssim_window.h"

namespace gsut {

// Weight w of 1 - SSIM. Source: Kerbl et al., "3D Gaussian splatting", 2023, equation 7.
inline constexpr double kDefaultSsimWeight = 0.2;

struct PhotometricOptions {
  WindowRule window_rule = WindowRule::kPartial;
  // Keep the blurred mean and variance of the target (24 bytes a pixel), which saves about a
  // seventh of the time of every call, instead of computing them again. Both ways give the same
  // bits.
  bool keep_statistics = false;
};

// Factors of a photograph's pixels (H, W, 3), shared by the targets of one camera.
class FalloffPlane {
 public:
  // Throws InputError: values that are not positive and finite.
  explicit FalloffPlane(std::vector<float> values);

  const std::vector<float>& values() const { return values_; }

 private:
  std::vector<float> values_;
};

// One training image, with all of the loss that does not depend on the rendered image.
// Threads may share one: a loss is of the light before or after another thread's SetLight.
// Memory: 3 (uint8) or 12 (float) bytes a pixel for the image, 24 with statistics, 5 with a mask.
class PhotometricTarget {
 public:
  // image: (H, W, 3) in [0, 1], or 8-bit for [0, 255] / 255, copied.
  // mask: (H, W), non-zero where a pixel counts, copied; null: all count. The image may hold
  // anything where it is masked.
  // Throws InputError: no pixels, a mask that leaves none, values that are not finite or far
  // outside [0, 1] at a pixel that counts.
  PhotometricTarget(const float* image, std::int64_t height, std::int64_t width,
                    const std::uint8_t* mask = nullptr, const PhotometricOptions& options = {});
  PhotometricTarget(const std::uint8_t* image, std::int64_t height, std::int64_t width,
                    const std::uint8_t* mask = nullptr, const PhotometricOptions& options = {});

  // The light that the photograph was taken in: the loss compares the image with the photograph's
  // values times `inverse_gain` of their channel times `inverse_falloff` of their pixel, so that
  // images know of neither. inverse_falloff: null: 1. If it is another object, statistics are
  // dropped; if it is then stated again, they are computed: a falloff that changes from one visit
  // of the target to the next would not be worth them.
  // Throws InputError: a gain that is not positive and finite, a plane of another size.
  void SetLight(const std::array<float, 3>& inverse_gain,
                std::shared_ptr<const FalloffPlane> inverse_falloff);

  std::int64_t height() const { return height_; }
  std::int64_t width() const { return width_; }
  std::int64_t pixels() const { return pixels_; }            // L1 is averaged over
  std::int64_t ssim_pixels() const { return ssim_pixels_; }  // SSIM is averaged over
  WindowRule window_rule() const { return window_rule_; }    // after the fallback
  std::int64_t bytes() const;  // of memory held, dropped statistics too

  // To be held while what the kernels read is read.
  std::shared_lock<std::shared_mutex> Reading() const { return std::shared_lock(light_mutex_); }

  // What the kernels read; null where absent.
  const float* float_image() const { return float_image_.empty() ? nullptr : float_image_.data(); }
  const std::uint8_t* byte_image() const {
    return byte_image_.empty() ? nullptr : byte_image_.data();
  }
  const std::uint8_t* mask() const { return mask_.empty() ? nullptr : mask_.data(); }
  const float* scale_plane() const { return scale_plane_.empty() ? nullptr : scale_plane_.data(); }
  const float* scale_rows() const { return scale_rows_.data(); }
  const float* scale_columns() const { return scale_columns_.data(); }
  const std::array<float, 3>& inverse_gain() const { return inverse_gain_; }
  bool has_gain() const { return inverse_gain_ != std::array<float, 3>{1.0f, 1.0f, 1.0f}; }
  const float* inverse_falloff() const {
    return inverse_falloff_ == nullptr ? nullptr : inverse_falloff_->values().data();
  }
  // Without the gain, with the falloff. kStatisticsPadding floats before and after the plane can be
  // read, too: numbers that mean nothing.
  static constexpr std::size_t kStatisticsPadding = 64;
  const float* mean() const { return mean_.empty() ? nullptr : &mean_[kStatisticsPadding]; }
  const float* variance() const {
    return variance_.empty() ? nullptr : &variance_[kStatisticsPadding];
  }

 private:
  void Prepare(const std::uint8_t* mask, const PhotometricOptions& options);
  void ComputeStatistics();

  std::int64_t height_ = 0, width_ = 0, pixels_ = 0, ssim_pixels_ = 0;
  WindowRule window_rule_ = WindowRule::kPartial;
  std::vector<float> float_image_;
  std::vector<std::uint8_t> byte_image_;
  std::vector<std::uint8_t> mask_;
  std::vector<float> scale_plane_, scale_rows_, scale_columns_;
  std::array<float, 3> inverse_gain_ = {1.0f, 1.0f, 1.0f};
  std::shared_ptr<const FalloffPlane> inverse_falloff_;
  bool keep_statistics_ = false;
  mutable std::shared_mutex light_mutex_;
  // (H, W, 3) of the image minus 0.5, in the SSIM window, between paddings.
  std::vector<float> mean_, variance_;
};

struct PhotometricValue {
  double loss = 0.0;   // (1 - w) l1 + w dssim
  double l1 = 0.0;     // mean absolute difference of unmasked pixels and channels
  double dssim = 0.0;  // 1 - SSIM, averaged by the target's window rule
};

// Value of the loss and, if gradient is not null, dloss_dimage (H, W, 3), which is overwritten
// (exactly 0 at masked pixels; the L1 part is 0 where both images are equal).
// image: (H, W, 3); may hold anything where it is masked. No image-sized memory is allocated; the
// same bits on any number of threads.
// Throws InputError if ssim_weight is outside [0, 1].
// Error against the double reference for values in [0, 1]: loss 5e-7 relative, gradient 2e-6
// relative (L2), from 30 unmasked pixels on (1.7e-5 below).
PhotometricValue PhotometricLoss(const PhotometricTarget& target, const float* image,
                                 double ssim_weight, float* gradient);

}  // namespace gsut
