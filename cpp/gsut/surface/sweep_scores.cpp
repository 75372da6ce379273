// Correlations of windows are sums over boxes, one distance after the other, so that all buffers of
// a distance stay in the cache; costs of paths run over all distances of a pixel at once. Both are
// plain loops without branches inside, which compilers turn into vector code; the order of their
// sums is fixed, and so are their bits. Callers work on several photographs at the same time.
#include "gsut/surface/sweep_scores.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace gsut {
namespace {

constexpr int kHalf = 2;          // of the windows: 5 x 5 pixels
constexpr int kBest = 3;          // correlations that count: some neighbours see something else
constexpr float kSteps = 1.5F;    // tried distances within which two photographs show the same
constexpr float kShare = 0.04F;   // of the inverse distance, likewise, where steps are finer
constexpr float kTrusted = 0.5F;  // trust above which a surface hides what lies behind it
constexpr int kLanes = 8;

// Means over windows, cut off at the border: first along rows, then down columns, five additions
// each, which a compiler does for many pixels at once; running sums would need double. `rows` is a
// buffer of the same size.
void AverageWindows(const SweepGrid& grid, const std::vector<float>& values,
                    std::vector<float>& rows, std::vector<float>& means) {
  const int width = grid.width, height = grid.height;
  for (int y = 0; y < height; ++y) {
    const float* in = values.data() + std::int64_t{y} * width;
    float* out = rows.data() + std::int64_t{y} * width;
    for (int x = kHalf; x < width - kHalf; ++x) {
      out[x] = (in[x - 2] + in[x - 1] + in[x] + in[x + 1] + in[x + 2]) * 0.2F;
    }
    for (int i = 0; i < std::min(2 * kHalf, width); ++i) {  // at both ends
      const int x = i < kHalf ? i : width - 1 - (i - kHalf);
      const int begin = std::max(0, x - kHalf), end = std::min(width, x + kHalf + 1);
      float sum = 0.0F;
      for (int k = begin; k < end; ++k) sum += in[k];
      out[x] = sum / static_cast<float>(end - begin);
    }
  }
  for (int y = 0; y < height; ++y) {
    const int begin = std::max(0, y - kHalf), end = std::min(height, y + kHalf + 1);
    const float share = 1.0F / static_cast<float>(end - begin);
    float* out = means.data() + std::int64_t{y} * width;
    std::fill(out, out + width, 0.0F);
    for (int k = begin; k < end; ++k) {
      const float* in = rows.data() + std::int64_t{k} * width;
      for (int x = 0; x < width; ++x) out[x] += in[x];
    }
    for (int x = 0; x < width; ++x) out[x] *= share;
  }
}

// Interpolates numbers at cells' centres along the rows of pixels.
class Cells {
 public:
  explicit Cells(const SweepGrid& grid)
      : grid_(grid),
        across_(Spread(grid.width, grid.columns())),
        down_(Spread(grid.height, grid.rows())),
        row_(grid.columns()) {}

  // values (width): of pixels of row y, from number `which` of `stride` numbers at each cell.
  void Interpolate(const float* numbers, int stride, int which, int y, std::vector<float>& values) {
    const Place& place = down_[y];
    const std::int64_t length = std::int64_t{grid_.columns()} * stride;
    const float* above = numbers + place.first * length + which;
    const float* below = numbers + place.second * length + which;
    for (int c = 0; c < grid_.columns(); ++c) {
      row_[c] = above[c * stride] + place.share * (below[c * stride] - above[c * stride]);
    }
    for (int x = 0; x < grid_.width; ++x) {
      const Place& at = across_[x];
      values[x] = row_[at.first] + at.share * (row_[at.second] - row_[at.first]);
    }
  }

 private:
  struct Place {
    int first, second;
    float share;
  };

  std::vector<Place> Spread(int pixels, int cells) const {
    std::vector<Place> places(pixels);
    for (int i = 0; i < pixels; ++i) {
      const float at = (static_cast<float>(i) + 0.5F) / static_cast<float>(grid_.cell) - 0.5F;
      const int first = std::clamp(static_cast<int>(std::floor(at)), 0, std::max(0, cells - 2));
      places[i] = {first, std::min(first + 1, cells - 1), at - static_cast<float>(first)};
    }
    return places;
  }

  SweepGrid grid_;
  std::vector<Place> across_, down_;
  std::vector<float> row_;
};

// Buffers of one distance.
struct Layer {
  explicit Layer(std::int64_t pixels)
      : seen(pixels),
        product(pixels),
        rows(pixels),
        mean(pixels),
        squares(pixels),
        both(pixels),
        geometry(pixels),
        hidden(pixels) {
    for (auto& each : best) each.resize(pixels);
  }
  std::vector<float> seen, product, rows, mean, squares, both, geometry, hidden;
  std::vector<float> columns_of, rows_of, nearness_of;  // of one row of pixels
  std::array<std::vector<float>, kBest> best;
};

// Looks a neighbour up at one distance. Where it shows nothing its grey value is 0, which
// correlates with nothing. Where a surface that it is sure of hides the point, a high correlation
// is chance.
void LookUp(const SweepGrid& grid, Cells& cells, const SweepNeighbour& other, int depth,
            const SweepOptions& options, Layer& layer) {
  const std::int64_t across = std::int64_t{grid.rows()} * grid.columns();
  const float* places = other.places + depth * across * 2;
  const float* nearness = other.nearness ? other.nearness + depth * across : nullptr;
  layer.columns_of.resize(grid.width);
  layer.rows_of.resize(grid.width);
  layer.nearness_of.resize(grid.width);
  for (int y = 0; y < grid.height; ++y) {
    cells.Interpolate(places, 2, 0, y, layer.columns_of);
    cells.Interpolate(places, 2, 1, y, layer.rows_of);
    if (nearness) cells.Interpolate(nearness, 1, 0, y, layer.nearness_of);
    for (int x = 0; x < grid.width; ++x) {
      const std::int64_t pixel = std::int64_t{y} * grid.width + x;
      const float u = layer.columns_of[x] - 0.5F, v = layer.rows_of[x] - 0.5F;
      layer.seen[pixel] = 0.0F;
      layer.hidden[pixel] = 0.0F;
      if (!(u >= 0.0F && v >= 0.0F && u <= static_cast<float>(other.width - 1) &&
            v <= static_cast<float>(other.height - 1))) {
        continue;
      }
      // Between the four pixels around; at the border the last pair serves.
      const int left = std::min(static_cast<int>(u), std::max(0, other.width - 2));
      const int top = std::min(static_cast<int>(v), std::max(0, other.height - 2));
      const int right = std::min(left + 1, other.width - 1);
      const std::int64_t above = std::int64_t{top} * other.width;
      const std::int64_t below = std::int64_t{std::min(top + 1, other.height - 1)} * other.width;
      const float s = u - static_cast<float>(left), t = v - static_cast<float>(top);
      const float* g = other.grey;
      const float upper = g[above + left] + s * (g[above + right] - g[above + left]);
      const float lower = g[below + left] + s * (g[below + right] - g[below + left]);
      layer.seen[pixel] = upper + t * (lower - upper);
      if (nearness == nullptr) continue;
      const std::int64_t at = (t < 0.5F ? above : below) + (s < 0.5F ? left : right);
      const float shown = other.shown[at];
      if (!(shown > 0.0F)) continue;
      // Nearer than the surface that the neighbour shows: it sees through; farther: it is hidden.
      const float off = layer.nearness_of[x] - shown;
      const float within = std::max(kSteps * options.step, kShare * shown);
      if (std::abs(off) < within) {
        layer.geometry[pixel] += options.agreement * other.trust[at];
      } else if (off > 0.0F) {
        layer.geometry[pixel] -= options.agreement * other.trust[at];
      } else if (other.trust[at] > kTrusted) {
        layer.hidden[pixel] = 1.0F;
      }
    }
  }
}

void Multiply(const std::vector<float>& a, const std::vector<float>& b, std::vector<float>& out) {
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = a[i] * b[i];
}

// Standard deviations of windows and noise together, inverse.
std::vector<float> InvertDeviations(const std::vector<float>& mean,
                                    const std::vector<float>& squares, float contrast) {
  std::vector<float> sharp(mean.size());
  for (std::size_t i = 0; i < mean.size(); ++i) {
    const float variance = std::max(squares[i] - mean[i] * mean[i], 0.0F);
    sharp[i] = 1.0F / std::sqrt(variance + contrast * contrast);
  }
  return sharp;
}

// Correlates what was looked up, and keeps it if it is among the best.
void Correlate(const SweepGrid& grid, const std::vector<float>& grey,
               const std::vector<float>& mean, const std::vector<float>& sharp, float contrast,
               Layer& layer) {
  AverageWindows(grid, layer.seen, layer.rows, layer.mean);
  Multiply(layer.seen, layer.seen, layer.product);
  AverageWindows(grid, layer.product, layer.rows, layer.squares);
  Multiply(layer.seen, grey, layer.product);
  AverageWindows(grid, layer.product, layer.rows, layer.both);
  float* const first = layer.best[0].data();
  float* const second = layer.best[1].data();
  float* const third = layer.best[2].data();
  for (std::size_t i = 0; i < grey.size(); ++i) {
    const float seen = layer.mean[i];
    const float variance = std::max(layer.squares[i] - seen * seen, 0.0F);
    float alike =
        (layer.both[i] - seen * mean[i]) * sharp[i] / std::sqrt(variance + contrast * contrast);
    alike = std::min(alike, layer.hidden[i] > 0.0F ? 0.0F : 1.0F);
    // The three best in falling order, without a branch.
    const float rest = std::min(first[i], alike);
    first[i] = std::max(first[i], alike);
    third[i] = std::max(third[i], std::min(second[i], rest));
    second[i] = std::max(second[i], rest);
  }
}

// Costs of paths in one direction, row by row: only the row before is kept. A pixel has two places
// more than distances, at both ends, whose cost is never the least.
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
  void Step(const float* scores, int x, int from, bool in_row, float change, float* total) {
    const int depths = grid_.depths;
    float* const out = now_.data() + std::int64_t{x} * length_ + 1;
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
    for (int d = 0; d < depths; ++d) {
      lanes[d % kLanes] = std::min(lanes[d % kLanes], out[d]);
      total[d] += out[d];
    }
    least_now_[x] = *std::min_element(lanes.begin(), lanes.end());
  }

  SweepGrid grid_;
  SweepOptions options_;
  int length_;
  std::vector<float> before_, now_, least_before_, least_now_;
};

}  // namespace

void ScoreWindows(const SweepGrid& grid, const float* grey,
                  std::span<const SweepNeighbour> neighbours, const SweepOptions& options,
                  float* scores) {
  Cells cells(grid);
  const std::int64_t pixels = grid.pixels();
  Layer layer(pixels);
  const std::vector<float> own(grey, grey + pixels);
  std::vector<float> mean(pixels), squares(pixels);
  AverageWindows(grid, own, layer.rows, mean);
  Multiply(own, own, layer.product);
  AverageWindows(grid, layer.product, layer.rows, squares);
  const std::vector<float> sharp = InvertDeviations(mean, squares, options.contrast);
  const int count = std::min<int>(kBest, static_cast<int>(neighbours.size()));
  for (int depth = 0; depth < grid.depths; ++depth) {
    for (auto& each : layer.best) std::fill(each.begin(), each.end(), -1.0F);
    std::fill(layer.geometry.begin(), layer.geometry.end(), 0.0F);
    for (const SweepNeighbour& other : neighbours) {
      LookUp(grid, cells, other, depth, options, layer);
      Correlate(grid, own, mean, sharp, options.contrast, layer);
    }
    for (std::int64_t i = 0; i < pixels; ++i) {
      float sum = 0.0F;
      for (int k = 0; k < count; ++k) sum += layer.best[k][i];
      scores[i * grid.depths + depth] =
          sum / static_cast<float>(std::max(1, count)) + layer.geometry[i];
    }
  }
}

void ChooseDistances(const SweepGrid& grid, const float* grey, const bool* counts,
                     const float* scores, const SweepOptions& options, float* best, float* score) {
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

}  // namespace gsut
