// The input of the kernels of all kinds of rays: the frame, the gradients to its pixels, and where
// those of the Gaussians go.
#pragma once

#include <cstdint>

#include "gsut/base/check_arguments.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/gaussians/harmonics_step.h"
#include "gsut/projection/view.h"

namespace gsut {

// Values that Gaussians carry beside their colour: blended by the same weights, with neither
// harmonics nor a clamp.
template <class T>
struct Channels {
  int count = 0;                  // D; 0: none
  const T* values = nullptr;      // (N, D)
  const T* background = nullptr;  // (D): what shows where nothing is

  // Throws InputError unless there is a row of them for each Gaussian.
  void Check(std::int64_t gaussians) const {
    if (count < 0) throw InputError("the number of channels is below 0");
    if (count == 0) return;
    CheckArray(values, gaussians, "channels");
    CheckGiven(background, "background of the channels");
  }
};

// What the kernels need to know of one frame.
struct RasterTask {
  GaussiansView<const float> gaussians;
  ViewFloats view;
  float log2_raw_min = 0;  // see Log2RawOf
  float max_cutoff = 0;
  float alpha_max = 0;
  float transmittance_min = 0;
  float background[3] = {0, 0, 0};
  float near_z = 0, far_z = 0;
  bool order_by_z = false;
  bool is_extinction = false;  // gaussians.response
  bool stop_before = false;
  float crossing =
      0.0f;  // a transmittance below it ends a pixel: transmittance_min or the next float
  bool with_depth = false;
  bool keep = false;  // leave what the backward pass needs
  int sh_degree = 0;
  Channels<float> channels;
};

// Where the Gaussians' gradients go.
struct GradientRows {
  GaussiansView<float> rows;     // shaped like the Gaussians
  std::uint8_t* touched;         // (N) becomes 1 where a pixel saw the Gaussian, else 0
  bool write_untouched = false;  // the others' rows become 0; else they stay as they are
  // If not null, the harmonics of touched rows take this step, and rows.sh is left as it is.
  const HarmonicsStep* step = nullptr;
  // (N) grows by the sum over pixels of blend weight x ImageGradients::error; null without it.
  float* error_sums = nullptr;
  float* channels = nullptr;  // (N, D), overwritten; null without ImageGradients::channels
};

// Pixel gradients as the user gives them, row-major; all but the first may be null.
struct ImageGradients {
  const float* image;                 // (H, W, 3)
  const float* alpha = nullptr;       // (H, W)
  const float* depth = nullptr;       // (H, W)
  const float* distortion = nullptr;  // (H, W)
  // (H, W): no gradient, but what a pixel charges the Gaussians that it sees with.
  const float* error = nullptr;
  const float* channels = nullptr;  // (H, W, D)

  bool HasDepth() const { return depth != nullptr || distortion != nullptr; }
};

}  // namespace gsut
