// What other photographs show of the surfaces that one photograph shows.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "gsut/cameras/camera.h"

namespace gsut {

inline constexpr int kShownValues = 9;  // of a pixel of a photograph

// A photograph and how far away it shows something; the caller keeps what it points to.
struct ShownView {
  const Camera* camera = nullptr;
  std::array<double, 12> pose{};     // rows of camera_from_world, 3 x 4
  const float* distances = nullptr;  // (H, W) of the camera, infinite where there is nothing
  const float* values = nullptr;     // (H, W, 9), the first three its colour
};

// Writes what the first `most` (at most 8) of the views that see a point at its distance, to
// `tolerance` (relative), show there: their number, and where they are at least `fewest` the
// medians (count, 9) of their values and the median (count) of the mean difference of their colours
// from the median colour; zeros elsewhere. points: (count, 3), world. One thread: callers compare
// photographs beside each other.
void CompareShown(std::int64_t count, const double* points, std::span<const ShownView> views,
                  double tolerance, int most, int fewest, float* medians, float* spreads,
                  std::int64_t* seen);

}  // namespace gsut
