// The pull-push pyramid of an image's surroundings, in float, rows in parallel.
#include "gsut/raster/surroundings.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "gsut/base/check_arguments.h"
#include "gsut/base/parallel.h"

namespace gsut {
namespace {

// Share of a pixel that may be open before anything is filled in: half a grey level at most.
constexpr float kOpen = 0.002f;
// Pixels a side that the finest level of the pyramid joins: what is filled in is soft.
constexpr int kFirstFactor = 4;
// Rows of a parallel part.
constexpr std::int64_t kRowGrain = 16;
// Red, green, blue and the share that is covered.
constexpr int kChannels = 4;
// Share of a pixel below which an overlap is rounding.
constexpr double kOverlap = 1e-9;

struct Level {
  int width = 0, height = 0;
  std::vector<float> pixels;  // (height, width, 4)

  Level(int w, int h) : width(w), height(h), pixels(static_cast<std::size_t>(kChannels) * w * h) {}
  float* At(int x, int y) {
    return &pixels[static_cast<std::size_t>(kChannels) * (static_cast<std::size_t>(y) * width + x)];
  }
  const float* At(int x, int y) const { return const_cast<Level*>(this)->At(x, y); }
};

// The pixels that a coarser pixel covers along one axis, and the share of it that each one takes.
struct Cover {
  int begin = 0;
  std::vector<float> shares;
};

// Coarser pixel k covers [k, k + 1) x from / to of the finer ones: sides need not divide each
// other, so pixels at its ends count in part. The shares of a coarser pixel add up to 1.
std::vector<Cover> CoversOf(int from, int to) {
  std::vector<Cover> covers(static_cast<std::size_t>(to));
  for (int k = 0; k < to; ++k) {
    const double begin = static_cast<double>(k) * from / to, end = (k + 1.0) * from / to;
    Cover& cover = covers[static_cast<std::size_t>(k)];
    cover.begin = static_cast<int>(begin);
    const int last = std::min(from, static_cast<int>(std::ceil(end - kOverlap)));
    for (int i = cover.begin; i < last; ++i) {
      const double overlap = std::min(end, i + 1.0) - std::max(begin, static_cast<double>(i));
      cover.shares.push_back(static_cast<float>(overlap / (end - begin)));
    }
  }
  return covers;
}

// Each pixel of the result is the mean of its area.
Level Shrink(const Level& from, int width, int height) {
  const std::vector<Cover> across = CoversOf(from.width, width);
  const std::vector<Cover> down = CoversOf(from.height, height);
  Level out(width, height);
  // Each row of the result is summed by one thread, in one order.
  ParallelFor(height, kRowGrain, [&](std::int64_t begin, std::int64_t end) {
    for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) {
      const Cover& rows = down[static_cast<std::size_t>(y)];
      for (std::size_t j = 0; j < rows.shares.size(); ++j) {
        for (int x = 0; x < width; ++x) {
          const Cover& columns = across[static_cast<std::size_t>(x)];
          const float* pixel = from.At(columns.begin, rows.begin + static_cast<int>(j));
          float* sum = out.At(x, y);
          for (const float share : columns.shares) {
            const float weight = rows.shares[j] * share;
            for (int c = 0; c < kChannels; ++c) sum[c] += weight * *pixel++;
          }
        }
      }
    }
  });
  return out;
}

// Where the centre of a finer pixel lies between two coarser ones along one axis.
struct Place {
  int low, high;
  float share;  // of the higher one
};

// Centres of pixels lie at k + 0.5; beyond the outermost ones the edge goes on as it is.
std::vector<Place> PlacesOf(int from, int to) {
  std::vector<Place> places(static_cast<std::size_t>(to));
  for (int k = 0; k < to; ++k) {
    const double at = std::clamp((k + 0.5) * from / to - 0.5, 0.0, from - 1.0);
    const int low = static_cast<int>(at);
    places[static_cast<std::size_t>(k)] = {low, std::min(from - 1, low + 1),
                                           static_cast<float>(at - low)};
  }
  return places;
}

// Calls use(x, y, color) for each pixel of a finer level, color (3): `from`, linear between the
// centres of its pixels.
template <class Use>
void Enlarge(const Level& from, int width, int height, const Use& use) {
  const std::vector<Place> across = PlacesOf(from.width, width);
  const std::vector<Place> down = PlacesOf(from.height, height);
  ParallelFor(height, kRowGrain, [&](std::int64_t begin, std::int64_t end) {
    for (int y = static_cast<int>(begin); y < static_cast<int>(end); ++y) {
      const Place row = down[static_cast<std::size_t>(y)];
      for (int x = 0; x < width; ++x) {
        const Place column = across[static_cast<std::size_t>(x)];
        const float* corners[] = {from.At(column.low, row.low), from.At(column.high, row.low),
                                  from.At(column.low, row.high), from.At(column.high, row.high)};
        float color[3];
        for (int c = 0; c < 3; ++c) {
          const float upper = corners[0][c] + column.share * (corners[1][c] - corners[0][c]);
          const float lower = corners[2][c] + column.share * (corners[3][c] - corners[2][c]);
          color[c] = upper + row.share * (lower - upper);
        }
        use(x, y, color);
      }
    }
  });
}

// What is known of the image: nothing where a pixel has no ray.
Level KnownPixels(int width, int height, const float* image, const float* alpha,
                  const std::uint8_t* valid) {
  Level known(width, height);
  for (std::size_t i = 0; i < static_cast<std::size_t>(width) * height; ++i) {
    if (valid[i] == 0) continue;
    std::copy_n(image + 3 * i, 3, &known.pixels[kChannels * i]);
    known.pixels[kChannels * i + 3] = alpha[i];
  }
  return known;
}

}  // namespace

// The finest level never enters the way back: what is filled in stays soft.
bool ComputeSurroundings(int width, int height, const float* image, const float* alpha,
                         const std::uint8_t* valid, float* behind) {
  if (width < 1 || height < 1) throw InputError("an image has at least one pixel");
  CheckGiven(image, "image");
  CheckGiven(alpha, "alpha");
  CheckGiven(valid, "valid");
  CheckGiven(behind, "behind");
  const std::size_t count = static_cast<std::size_t>(width) * height;
  // Nothing is open in most photographs: the pyramid is built only where it shows.
  bool open = false;
  for (std::size_t i = 0; i < count && !open; ++i) open = valid[i] != 0 && alpha[i] < 1.0f - kOpen;
  if (!open) return false;
  const auto divide = [](int side, int factor) { return (side + factor - 1) / factor; };
  std::vector<Level> levels;
  if (std::max(width, height) > 1) {
    const Level known = KnownPixels(width, height, image, alpha, valid);
    levels.push_back(Shrink(known, divide(width, kFirstFactor), divide(height, kFirstFactor)));
  } else {
    levels.push_back(KnownPixels(width, height, image, alpha, valid));
  }
  // Pull: what is known, and how much of it there is, becomes coarser down to one pixel.
  while (std::max(levels.back().width, levels.back().height) > 1) {
    const Level& last = levels.back();
    levels.push_back(Shrink(last, divide(last.width, 2), divide(last.height, 2)));
  }
  Level out = std::move(levels.back());
  levels.pop_back();
  // The last pixel is divided by its share: the mean colour of all that is covered. Where nothing
  // is, black stays black.
  const float covered = std::max(out.pixels[3], std::numeric_limits<float>::min());
  for (float& value : out.pixels) value /= covered;
  // Push: what a level knows lies over the coarser one, by the share that it covers.
  for (; !levels.empty(); levels.pop_back()) {
    Level& level = levels.back();
    Enlarge(out, level.width, level.height, [&](int x, int y, const float* color) {
      float* pixel = level.At(x, y);
      for (int c = 0; c < 3; ++c) pixel[c] += (1.0f - pixel[3]) * color[c];
    });
    out = std::move(level);
  }
  // To the image itself, whose own pixels are blended over it by the caller.
  Enlarge(out, width, height, [&](int x, int y, const float* color) {
    const std::size_t i = static_cast<std::size_t>(y) * width + x;
    for (std::size_t c = 0; c < 3; ++c) behind[3 * i + c] = valid[i] == 0 ? 0.0f : color[c];
  });
  return true;
}

}  // namespace gsut
