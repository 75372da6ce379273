// Correlations of windows are sums over boxes, one distance after the other, so that all buffers of
// a distance stay in the cache. Plain loops without branches inside become vector code, once per
// instruction set; the order of their sums is fixed, and so are their bits. Callers work on several
// photographs at the same time.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/surface/sweep_scores.cpp"
#include "gsut/base/hwy_targets.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "gsut/surface/sweep_scores.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

constexpr int kHalf = 2;          // of the windows: 5 x 5 pixels
constexpr int kBest = 3;          // correlations that count: some neighbours see something else
constexpr float kSteps = 1.5F;    // tried distances within which two photographs show the same
constexpr float kShare = 0.04F;   // of the inverse distance, likewise, where steps are finer
constexpr float kTrusted = 0.5F;  // trust above which a surface hides what lies behind it
constexpr int kBlock = 16;        // distances whose scores are written together: a cache line
constexpr int kPadding = 16;      // pixels of a last vector beyond a row

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

// Interpolates numbers at cells' centres along the rows of pixels, linearly both ways; what lies
// beyond the outer centres is extrapolated.
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

// Buffers of one row of pixels.
struct Row {
  explicit Row(int width) : corner(width + kPadding), beside(width + kPadding) {
    for (std::vector<float>* each : {&u, &v, &s, &t, &inside, &nearness, &shown, &trust}) {
      each->resize(width + kPadding);
    }
    for (auto& each : around) each.resize(width);
  }
  std::vector<float> u, v;                   // place in the neighbour
  std::vector<float> s, t, inside;           // share of the pixel to the right and below; 1: inside
  std::array<std::vector<float>, 4> around;  // grey values of the four pixels around
  std::vector<float> nearness, shown, trust;
  std::vector<int> corner, beside;  // first of the four pixels, and the nearest
};

// Buffers of one distance: what a neighbour shows at each pixel and its products, their means over
// windows, and the best correlations of all neighbours so far.
struct Layer {
  explicit Layer(const SweepGrid& grid) : row(grid.width) {
    for (std::vector<float>* each :
         {&seen, &product, &rows, &mean, &squares, &both, &geometry, &hidden}) {
      each->resize(grid.pixels());
    }
    for (auto& each : best) each.resize(grid.pixels());
  }
  std::vector<float> seen, product, rows, mean, squares, both, geometry, hidden;
  std::array<std::vector<float>, kBest> best;
  Row row;
};

// Looks the places of a row up between the four pixels around; at the border the last pair serves.
// Where the neighbour shows nothing its grey value is 0, which correlates with nothing.
void LookUpRow(const SweepNeighbour& other, int width, Row& row, float* HWY_RESTRICT seen) {
  const int last_left = std::max(0, other.width - 2), last_top = std::max(0, other.height - 2);
  const int right = std::min(1, other.width - 1);
  const int down = other.height > 1 ? other.width : 0;
  const hn::ScalableTag<float> f;
  const hn::RebindToSigned<decltype(f)> n;
  const auto zero = hn::Zero(f), half = hn::Set(f, 0.5F);
  const auto last_u = hn::Set(f, static_cast<float>(other.width - 1));
  const auto last_v = hn::Set(f, static_cast<float>(other.height - 1));
  for (int x = 0; x < width; x += static_cast<int>(hn::Lanes(f))) {
    const auto at_u = hn::Sub(hn::LoadU(f, row.u.data() + x), half);
    const auto at_v = hn::Sub(hn::LoadU(f, row.v.data() + x), half);
    const auto in = hn::And(hn::And(hn::Ge(at_u, zero), hn::Le(at_u, last_u)),
                            hn::And(hn::Ge(at_v, zero), hn::Le(at_v, last_v)));
    const auto u = hn::IfThenElseZero(in, at_u), v = hn::IfThenElseZero(in, at_v);
    const auto left = hn::Min(hn::ConvertTo(n, u), hn::Set(n, last_left));
    const auto top = hn::Min(hn::ConvertTo(n, v), hn::Set(n, last_top));
    const auto s = hn::Sub(u, hn::ConvertTo(f, left)), t = hn::Sub(v, hn::ConvertTo(f, top));
    const auto corner = hn::Add(hn::Mul(top, hn::Set(n, other.width)), left);
    const auto below = hn::RebindMask(n, hn::Ge(t, half));
    const auto beside = hn::RebindMask(n, hn::Ge(s, half));
    const auto step = hn::Add(hn::IfThenElseZero(below, hn::Set(n, down)),
                              hn::IfThenElseZero(beside, hn::Set(n, right)));
    hn::StoreU(s, f, row.s.data() + x);
    hn::StoreU(t, f, row.t.data() + x);
    hn::StoreU(hn::IfThenElseZero(in, hn::Set(f, 1.0F)), f, row.inside.data() + x);
    hn::StoreU(corner, n, row.corner.data() + x);
    hn::StoreU(hn::Add(corner, step), n, row.beside.data() + x);
  }
  // Gathered one by one, as fast as gather instructions and the same with all instruction sets.
  const int* HWY_RESTRICT corner = row.corner.data();
  float *HWY_RESTRICT a = row.around[0].data(), *HWY_RESTRICT b = row.around[1].data();
  float *HWY_RESTRICT c = row.around[2].data(), *HWY_RESTRICT d = row.around[3].data();
  for (int x = 0; x < width; ++x) {
    const float* g = other.grey + corner[x];
    a[x] = g[0];
    b[x] = g[right];
    c[x] = g[down];
    d[x] = g[down + right];
  }
  const float *HWY_RESTRICT s = row.s.data(), *HWY_RESTRICT t = row.t.data();
  const float* HWY_RESTRICT inside = row.inside.data();
  for (int x = 0; x < width; ++x) {
    const float upper = a[x] + s[x] * (b[x] - a[x]), lower = c[x] + s[x] * (d[x] - c[x]);
    seen[x] = inside[x] > 0.0F ? upper + t[x] * (lower - upper) : 0.0F;
  }
}

// Compares the inverse distances of a row with the surfaces that the neighbour shows there. Nearer
// than these: it sees through. Farther: it is hidden, and a high correlation is chance if the
// neighbour is sure.
void CompareRow(const SweepNeighbour& other, const SweepOptions& options, int width, Row& row,
                float* HWY_RESTRICT geometry, float* HWY_RESTRICT hidden) {
  float *HWY_RESTRICT shown = row.shown.data(), *HWY_RESTRICT trust = row.trust.data();
  const int* HWY_RESTRICT beside = row.beside.data();
  for (int x = 0; x < width; ++x) {
    shown[x] = other.shown[beside[x]];
    trust[x] = other.trust[beside[x]];
  }
  const float *HWY_RESTRICT inside = row.inside.data(), *HWY_RESTRICT near = row.nearness.data();
  const float least = kSteps * options.step, agreement = options.agreement;
  for (int x = 0; x < width; ++x) {
    const bool known = (inside[x] > 0.0F) & (shown[x] > 0.0F);
    const float off = near[x] - shown[x];
    const bool same = std::abs(off) < std::max(least, kShare * shown[x]);
    const bool before = off > 0.0F;
    const float more = same ? agreement : before ? -agreement : 0.0F;
    geometry[x] += known ? more * trust[x] : 0.0F;
    hidden[x] = known & !same & !before & (trust[x] > kTrusted) ? 1.0F : 0.0F;
  }
}

// Looks a neighbour up at one distance.
void LookUp(const SweepGrid& grid, Cells& cells, const SweepNeighbour& other, int depth,
            const SweepOptions& options, Layer& layer) {
  const std::int64_t across = std::int64_t{grid.rows()} * grid.columns();
  const float* places = other.places + depth * across * 2;
  for (int y = 0; y < grid.height; ++y) {
    const std::int64_t begin = std::int64_t{y} * grid.width;
    cells.Interpolate(places, 2, 0, y, layer.row.u);
    cells.Interpolate(places, 2, 1, y, layer.row.v);
    LookUpRow(other, grid.width, layer.row, layer.seen.data() + begin);
    if (other.nearness == nullptr) {
      std::fill_n(layer.hidden.data() + begin, grid.width, 0.0F);
      continue;
    }
    cells.Interpolate(other.nearness + depth * across, 1, 0, y, layer.row.nearness);
    CompareRow(other, options, grid.width, layer.row, layer.geometry.data() + begin,
               layer.hidden.data() + begin);
  }
}

// Multiplies pixel by pixel.
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

// The mean of the best `count` correlations, and what the neighbours show.
void SumScores(const Layer& layer, int count, float* HWY_RESTRICT scores) {
  const float share = static_cast<float>(std::max(1, count));
  for (std::size_t i = 0; i < layer.geometry.size(); ++i) {
    float sum = 0.0F;
    for (int k = 0; k < count; ++k) sum += layer.best[k][i];
    scores[i] = sum / share + layer.geometry[i];
  }
}

}  // namespace

void Score(const SweepGrid& grid, const float* grey, std::span<const SweepNeighbour> neighbours,
           const SweepOptions& options, float* scores) {
  Cells cells(grid);
  const std::int64_t pixels = grid.pixels();
  Layer layer(grid);
  std::vector<float> block(kBlock * pixels);
  const std::vector<float> own(grey, grey + pixels);
  std::vector<float> mean(pixels), squares(pixels);
  AverageWindows(grid, own, layer.rows, mean);
  Multiply(own, own, layer.product);
  AverageWindows(grid, layer.product, layer.rows, squares);
  const std::vector<float> sharp = InvertDeviations(mean, squares, options.contrast);
  const int count = std::min<int>(kBest, static_cast<int>(neighbours.size()));
  // Scores of a pixel lie side by side, and those of a distance are made together: a block of
  // distances is turned over at once, so that each cache line of `scores` is written once.
  for (int depth = 0; depth < grid.depths; ++depth) {
    for (auto& each : layer.best) std::fill(each.begin(), each.end(), -1.0F);
    std::fill(layer.geometry.begin(), layer.geometry.end(), 0.0F);
    for (const SweepNeighbour& other : neighbours) {
      LookUp(grid, cells, other, depth, options, layer);
      Correlate(grid, own, mean, sharp, options.contrast, layer);
    }
    const int of_block = depth % kBlock;
    SumScores(layer, count, block.data() + of_block * pixels);
    if (of_block + 1 < kBlock && depth + 1 < grid.depths) continue;
    float* const out = scores + depth - of_block;
    for (std::int64_t i = 0; i < pixels; ++i) {
      for (int k = 0; k <= of_block; ++k) out[i * grid.depths + k] = block[k * pixels + i];
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {

HWY_EXPORT(Score);

void ScoreWindows(const SweepGrid& grid, const float* grey,
                  std::span<const SweepNeighbour> neighbours, const SweepOptions& options,
                  float* scores) {
  HWY_DYNAMIC_DISPATCH(Score)(grid, grey, neighbours, options, scores);
}

}  // namespace gsut
#endif  // HWY_ONCE
