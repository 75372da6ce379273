// Photometric loss: checks, split into blocks, sums in a fixed order.
#include "gsut/loss/photometric.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/loss/photometric_kernel.h"

namespace gsut {
namespace {

// Largest block. Its line buffers (about 90 rows of 3 floats a column) stay in a 1 MB L2 cache;
// the margin of 10 pixels that neighbouring blocks compute twice costs about a fifth of the time.
constexpr std::int64_t kBlockRows = 64;
constexpr std::int64_t kBlockColumns = 512;

// Values this far outside [0, 1] are taken for a wrong scale (0..255), not for overshoot.
constexpr float kRangeSlack = 1.0f;

// The image cut into equal blocks, independent of the number of threads.
// As near to kBlockRows x kBlockColumns as equal parts can be.
class BlockGrid {
 public:
  BlockGrid(std::int64_t height, std::int64_t width)
      : height_(height),
        width_(width),
        rows_(DivideUp(height, DivideUp(height, kBlockRows))),
        columns_(DivideUp(width, DivideUp(width, kBlockColumns))),
        across_(DivideUp(width, columns_)),
        count_(DivideUp(height, rows_) * across_) {}

  std::int64_t count() const { return count_; }
  ImageBlock operator[](std::int64_t index) const {
    const std::int64_t row = index / across_ * rows_;
    const std::int64_t column = index % across_ * columns_;
    return {row, std::min(height_, row + rows_), column, std::min(width_, column + columns_)};
  }

 private:
  static std::int64_t DivideUp(std::int64_t a, std::int64_t b) { return (a + b - 1) / b; }
  std::int64_t height_, width_, rows_, columns_, across_, count_;
};

// Once a photograph, so that no step has to look for what is not finite.
void CheckValues(const std::vector<float>& image, const std::uint8_t* mask, std::int64_t width) {
  for (std::size_t i = 0; i < image.size(); ++i) {
    const float value = image[i];
    // Written so that NaN fails.
    if (value >= -kRangeSlack && value <= 1.0f + kRangeSlack) continue;
    const auto pixel = static_cast<std::int64_t>(i / 3);
    if (mask != nullptr && mask[pixel] == 0) continue;
    throw InputError("the target image holds " + std::to_string(value) + " at row " +
                     std::to_string(pixel / width) + ", column " + std::to_string(pixel % width) +
                     "; give finite values in [0, 1], or 8-bit values, or mask the pixel out");
  }
}

void CheckFactor(float value, const char* name) {
  if (value > 0.0f && std::isfinite(value)) return;
  throw InputError(std::string(name) + " holds " + std::to_string(value) +
                   "; give positive, finite values");
}

template <class To>
std::vector<To> Rounded(const std::vector<double>& values) {
  return std::vector<To>(values.begin(), values.end());
}

}  // namespace

FalloffPlane::FalloffPlane(std::vector<float> values) : values_(std::move(values)) {
  for (const float value : values_) CheckFactor(value, "inverse_falloff");
}

PhotometricTarget::PhotometricTarget(const float* image, std::int64_t height, std::int64_t width,
                                     const std::uint8_t* mask, const PhotometricOptions& options)
    : height_(height), width_(width), pixels_(CountPixels(mask, height, width)) {
  CheckGiven(image, "image");
  float_image_.assign(image, image + height * width * 3);
  CheckValues(float_image_, mask, width);
  Prepare(mask, options);
}

PhotometricTarget::PhotometricTarget(const std::uint8_t* image, std::int64_t height,
                                     std::int64_t width, const std::uint8_t* mask,
                                     const PhotometricOptions& options)
    : height_(height), width_(width), pixels_(CountPixels(mask, height, width)) {
  CheckGiven(image, "image");
  byte_image_.assign(image, image + height * width * 3);
  Prepare(mask, options);
}

void PhotometricTarget::Prepare(const std::uint8_t* mask, const PhotometricOptions& options) {
  // All that depends on the photograph alone is made here, once for all steps of a training.
  // A mask that masks nothing is none.
  if (pixels_ == height_ * width_) mask = nullptr;
  if (mask != nullptr) mask_.assign(mask, mask + height_ * width_);
  const WindowScale scale = MakeWindowScale(mask, height_, width_, options.window_rule);
  window_rule_ = scale.rule;
  ssim_pixels_ = scale.pixels;
  scale_plane_ = Rounded<float>(scale.plane);
  scale_rows_ = Rounded<float>(scale.rows);
  scale_columns_ = Rounded<float>(scale.columns);
  keep_statistics_ = options.keep_statistics;
  if (keep_statistics_) ComputeStatistics();
}

// Mean and variance of the photograph in each window: half of SSIM's blurs, the same at each step.
void PhotometricTarget::ComputeStatistics() {
  std::vector<float> mean(static_cast<std::size_t>(height_ * width_ * 3) + 2 * kStatisticsPadding);
  std::vector<float> variance(mean.size());
  const BlockGrid grid(height_, width_);
  ParallelFor(grid.count(), 1, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      TargetStatisticsBlock(*this, grid[i], &mean[kStatisticsPadding],
                            &variance[kStatisticsPadding]);
    }
  });
  mean_ = std::move(mean);
  variance_ = std::move(variance);
}

void PhotometricTarget::SetLight(const std::array<float, 3>& inverse_gain,
                                 std::shared_ptr<const FalloffPlane> inverse_falloff) {
  for (const float value : inverse_gain) CheckFactor(value, "inverse_gain");
  const std::unique_lock lock(light_mutex_);
  inverse_gain_ = inverse_gain;
  // A gain scales mean and variance of a window by g and g^2, so that kept statistics stay valid; a
  // falloff changes from pixel to pixel, so that they must be computed again.
  if (inverse_falloff == inverse_falloff_) {
    if (keep_statistics_ && mean_.empty()) ComputeStatistics();
    return;
  }
  if (inverse_falloff != nullptr &&
      static_cast<std::int64_t>(inverse_falloff->values().size()) != height_ * width_ * 3) {
    throw InputError("inverse_falloff has " + std::to_string(inverse_falloff->values().size()) +
                     " values; give three for each of " + std::to_string(height_ * width_) +
                     " pixels");
  }
  inverse_falloff_ = std::move(inverse_falloff);
  mean_.clear();
  variance_.clear();
}

std::int64_t PhotometricTarget::bytes() const {
  const std::int64_t statistics = keep_statistics_ ? 2 * 3 * height_ * width_ : 0;
  const std::size_t floats = float_image_.size() + scale_plane_.size() + scale_rows_.size() +
                             scale_columns_.size() + static_cast<std::size_t>(statistics);
  return static_cast<std::int64_t>(floats * sizeof(float) + byte_image_.size() + mask_.size());
}

PhotometricValue PhotometricLoss(const PhotometricTarget& target, const float* image,
                                 double ssim_weight, float* gradient) {
  CheckGiven(image, "image");
  if (!(ssim_weight >= 0.0 && ssim_weight <= 1.0)) {
    throw InputError("ssim_weight is " + std::to_string(ssim_weight) + "; give a value in [0, 1]");
  }
  const auto reading = target.Reading();
  constexpr double kChannels = 3.0;
  // loss = (1 - w) mean |x - y| + w mean (1 - SSIM) / 2. The factors of both means go into the
  // gradient as it is formed: no second pass over the image.
  const double l1_count = kChannels * static_cast<double>(target.pixels());
  const double ssim_count = kChannels * static_cast<double>(target.ssim_pixels());
  const auto l1_factor = static_cast<float>((1.0 - ssim_weight) / l1_count);
  const auto dssim_factor = static_cast<float>(ssim_weight / ssim_count);
  // Blocks follow from the image's size alone, and each writes its own part of the gradient: SSIM's
  // windows reach over the edge, so that a block reads a margin of 10 pixels around it.
  const BlockGrid grid(target.height(), target.width());
  std::vector<BlockSums> sums(static_cast<std::size_t>(grid.count()));
  ParallelFor(grid.count(), 1, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      sums[static_cast<std::size_t>(i)] =
          PhotometricBlock(target, image, grid[i], l1_factor, dssim_factor, gradient);
    }
  });
  // In the order of the blocks: the same bits on any number of threads.
  PhotometricValue value;
  for (const BlockSums& sum : sums) {
    value.l1 += sum.absolute;
    value.dssim += sum.dssim;
  }
  value.l1 /= l1_count;
  value.dssim /= ssim_count;
  value.loss = (1.0 - ssim_weight) * value.l1 + ssim_weight * value.dssim;
  return value;
}

}  // namespace gsut
