// What several views say of the same points: whether their depths agree, and the points' colours.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "gsut/surface/depth_view.h"

namespace gsut {

// support (H, W) of views[which]: how many of the views `others` see the point at a pixel's depth
// at that distance themselves, to within `tolerance` of it (relative).
void CountSupport(const std::vector<DepthView>& views, std::size_t which,
                  std::span<const std::size_t> others, double tolerance, std::uint8_t* support);

// colors (count, 3) in [0, 1]: mean of the images (H, W, 3; 8 bits) over the views that see a point
// at no more than `tolerance` (world units) behind their own depth, by cosine over squared
// distance; NaN where none does. points (count, 3): about the views' centre.
void ColorPoints(const std::vector<DepthView>& views, std::span<const std::uint8_t* const> images,
                 std::int64_t count, const double* points, double tolerance, float* colors);

}  // namespace gsut
