// The distance of each pixel that agrees best, beside pixels whose distances are alike.
#pragma once

#include "gsut/surface/sweep_scores.h"

namespace gsut {

// best (height, width): number of the distance, with a fraction, of the least cost along eight
// directions (Hirschmüller, "Stereo processing by semiglobal matching and mutual information",
// 2008); `counts` (height, width) is false where a pixel has no scores and takes what is beside it.
// score (height, width): that of the distance chosen. Same bits everywhere.
void ChooseDistances(const SweepGrid& grid, const float* grey, const bool* counts,
                     const float* scores, const SweepOptions& options, float* best, float* score);

}  // namespace gsut
