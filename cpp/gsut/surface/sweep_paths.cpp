// Costs of paths run over all distances of a pixel at once: plain loops without branches inside,
// which compilers turn into vector code, once per instruction set. The order of their sums is
// fixed, and so are their bits.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/surface/sweep_paths.cpp"
#include "gsut/base/hwy_targets.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "gsut/surface/sweep_paths.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

constexpr int kLanes = 16;  // costs compared at once

// Costs of paths in one direction, row by row: only the row before is kept.
class Paths {
 public:
  Paths(const SweepGrid& grid, const SweepOptions& options)
      : grid_(grid),
        options_(options),
        length_(grid.depths + 2),
        before_(std::int64_t{grid.width} * length_),
        now_(before_.size()),
        least_before_(grid.width),
        least_now_(grid.width) {}

  // A path's cost at a pixel is that of the pixel, and the least of: the same distance before, one
  // beside it, or any other at the price of an edge; less the least of all before, which keeps the
  // sums small and changes no choice.
  //
  // Adds the costs of paths that come from (x - dx, y - dy) to `total` (height, width, depths).
  void Add(const float* grey, const bool* counts, const float* scores, int dx, int dy,
           float* total) {
    const bool up = dy < 0 || (dy == 0 && dx < 0);
    for (int i = 0; i < grid_.height; ++i) {
      const int y = up ? grid_.height - 1 - i : i;
      for (int j = 0; j < grid_.width; ++j) {
        const int x = up ? grid_.width - 1 - j : j;
        const int from_x = x - dx, from_y = y - dy;
        const bool begins =
            from_x < 0 || from_y < 0 || from_x >= grid_.width || from_y >= grid_.height;
        const std::int64_t pixel = std::int64_t{y} * grid_.width + x;
        const std::int64_t from = std::int64_t{from_y} * grid_.width + from_x;
        const float change = begins ? 0.0F : std::abs(grey[pixel] - grey[from]);
        Step(counts[pixel] ? scores + pixel * grid_.depths : nullptr, x, begins ? -1 : from_x,
             dy == 0, change, total + pixel * grid_.depths);
      }
      std::swap(before_, now_);
      std::swap(least_before_, least_now_);
    }
  }

 private:
  // Makes the costs of one pixel from those of the pixel before on the path; none: it begins here.
  void Step(const float* scores, int x, int from, bool in_row, float change, float* total) {
    const int depths = grid_.depths;
    float* const out = now_.data() + std::int64_t{x} * length_ + 1;
    // Two places more than distances, at both ends, whose cost is never the least.
    out[-1] = out[depths] = std::numeric_limits<float>::max();
    if (from < 0) {
      for (int d = 0; d < depths; ++d) out[d] = scores ? 1.0F - scores[d] : 0.0F;
    } else {
      const float* const came = (in_row ? now_ : before_).data() + std::int64_t{from} * length_ + 1;
      const float least = (in_row ? least_now_ : least_before_)[from];
      const float jump = least + std::max(options_.near_step, options_.far_step * options_.edge /
                                                                  (options_.edge + change));
      for (int d = 0; d < depths; ++d) {
        const float beside = std::min(came[d - 1], came[d + 1]) + options_.near_step;
        out[d] = std::min(std::min(came[d], beside), jump) - least;
      }
      // A pixel that does not count passes on what came.
      if (scores) {
        for (int d = 0; d < depths; ++d) out[d] += 1.0F - scores[d];
      }
    }
    // Several minima side by side: one alone would wait for each comparison before the next.
    std::array<float, kLanes> lanes;
    lanes.fill(std::numeric_limits<float>::max());
    for (int d = 0; d < depths; ++d) total[d] += out[d];
    int done = 0;
    for (; done + kLanes <= depths; done += kLanes) {
      for (int k = 0; k < kLanes; ++k) lanes[k] = std::min(lanes[k], out[done + k]);
    }
    for (; done < depths; ++done) lanes[0] = std::min(lanes[0], out[done]);
    least_now_[x] = *std::min_element(lanes.begin(), lanes.end());
  }

  SweepGrid grid_;
  SweepOptions options_;
  int length_;
  std::vector<float> before_, now_, least_before_, least_now_;
};

}  // namespace

// Sums the costs of paths from the eight pixels around, and takes the least of each pixel.
void Choose(const SweepGrid& grid, const float* grey, const bool* counts, const float* scores,
            const SweepOptions& options, float* best, float* score) {
  std::vector<float> total(grid.pixels() * grid.depths);
  Paths paths(grid, options);
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      if (dx != 0 || dy != 0) paths.Add(grey, counts, scores, dx, dy, total.data());
    }
  }
  const int last = grid.depths - 1;
  for (std::int64_t i = 0; i < grid.pixels(); ++i) {
    const float* costs = total.data() + i * grid.depths;
    const int least = static_cast<int>(std::min_element(costs, costs + grid.depths) - costs);
    best[i] = static_cast<float>(least);
    if (least > 0 && least < last) {  // the vertex of a parabola
      const float before = costs[least - 1], after = costs[least + 1];
      const float bend = before + after - 2.0F * costs[least];
      if (bend > 0.0F) best[i] += 0.5F * (before - after) / bend;
    }
    score[i] = counts[i] ? scores[i * grid.depths + least] : 0.0F;
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {

HWY_EXPORT(Choose);

void ChooseDistances(const SweepGrid& grid, const float* grey, const bool* counts,
                     const float* scores, const SweepOptions& options, float* best, float* score) {
  HWY_DYNAMIC_DISPATCH(Choose)(grid, grey, counts, scores, options, best, score);
}

}  // namespace gsut
#endif  // HWY_ONCE
