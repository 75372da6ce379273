// Moves depths to where windows of the photographs correlate best with neighbouring photographs.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "gsut/surface/depth_view.h"

namespace gsut {

// Moves depth (H, W) of views[which] along its rays. A window of 7 x 7 pixels lies on the plane of
// a pixel's distance and normal, and is looked up in the neighbours at five distances, half a pixel
// of the most sensitive neighbour apart. The distance becomes that of the largest sum of
// correlations, to a parabola's precision, where this lies within the five; elsewhere it stays.
// moved (H, W): 1 where it did not. others: neighbours. greys: of all views, (H, W) in [0, 1], NaN
// where masked. normals (H, W, 3): of the surface, world axes, any length; 0 where unknown.
void RefineDepth(const std::vector<DepthView>& views, std::size_t which,
                 std::span<const std::size_t> others, std::span<const float* const> greys,
                 const float* normals, float* depth, std::uint8_t* moved);

}  // namespace gsut
