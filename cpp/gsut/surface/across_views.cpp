// Batches of points through one view after the other.
#include "gsut/surface/across_views.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

constexpr std::int64_t kRows = 4;
constexpr int kLanes = 16;  // points are projected in multiples of it

// Projects the first `count` points of a batch; the rest is filled with the last.
void ProjectSome(const DepthView& view, int count, PointBatch* points, ViewedBatch* out) {
  const int whole = (count + kLanes - 1) / kLanes * kLanes;
  for (float* axis : {points->x, points->y, points->z}) {
    std::fill(axis + count, axis + whole, axis[count - 1]);
  }
  view.Project(whole, *points, out);
}

// Bilinear between pixel centres, levels of 0 to 1.
// Adds weight times the image at (u, v); beyond the outermost centres their values hold.
void AddColor(const DepthView& view, const std::uint8_t* image, float u, float v, float weight,
              float* sum) {
  const float left = std::clamp(u - 0.5f, 0.0f, static_cast<float>(view.width() - 1));
  const float up = std::clamp(v - 0.5f, 0.0f, static_cast<float>(view.height() - 1));
  const int x = static_cast<int>(left), y = static_cast<int>(up);
  const int next_x = std::min(x + 1, view.width() - 1), next_y = std::min(y + 1, view.height() - 1);
  const float a = left - static_cast<float>(x), b = up - static_cast<float>(y);
  const auto level = [&](int column, int row, int channel) {
    return static_cast<float>(
        image[3 * (static_cast<std::size_t>(row) * view.width() + column) + channel]);
  };
  for (int c = 0; c < 3; ++c) {
    const float above = level(x, y, c) + a * (level(next_x, y, c) - level(x, y, c));
    const float below = level(x, next_y, c) + a * (level(next_x, next_y, c) - level(x, next_y, c));
    sum[c] += weight * (above + b * (below - above)) / 255.0f;
  }
}

}  // namespace

// A depth is supported by another view that sees a surface at the same place: its point is
// projected there, and the depths compared. In batches, so that the lens' vector kernels are full.
void CountSupport(const std::vector<DepthView>& views, std::size_t which,
                  std::span<const std::size_t> others, double tolerance, std::uint8_t* support) {
  const DepthView& view = views[which];
  std::fill_n(support, static_cast<std::size_t>(view.width()) * view.height(), std::uint8_t{0});
  ParallelFor(view.height(), kRows, [&](std::int64_t begin, std::int64_t end) {
    PointBatch points;
    ViewedBatch seen;
    std::vector<std::size_t> pixels;
    // The points gathered so far, through every other view; then room for the next.
    const auto flush = [&] {
      if (pixels.empty()) return;
      for (const std::size_t other : others) {
        ProjectSome(views[other], static_cast<int>(pixels.size()), &points, &seen);
        for (std::size_t i = 0; i < pixels.size(); ++i) {
          DepthSample sample;
          if (!views[other].Sample(seen.u[i], seen.v[i], &sample)) continue;
          // Relative to the distance: depth errors grow with it.
          const float apart = std::abs(sample.depth - seen.distance[i]);
          support[pixels[i]] += apart <= static_cast<float>(tolerance) * seen.distance[i];
        }
      }
      pixels.clear();
    };
    for (int y = static_cast<int>(begin); y < end; ++y) {
      for (int x = 0; x < view.width(); ++x) {
        DepthSample sample;
        if (!view.At(x, y, &sample) || sample.depth > DepthSample::kFree) continue;
        const Eigen::Vector3f point = view.PointOf(x, y, double{sample.depth}).cast<float>();
        const std::size_t i = pixels.size();
        points.x[i] = point[0], points.y[i] = point[1], points.z[i] = point[2];
        pixels.push_back(static_cast<std::size_t>(y) * view.width() + x);
        if (pixels.size() == kPointBatch) flush();
      }
    }
    flush();
  });
}

// The mean colour over the views that see a point, not one before it, weighted as the depth fusion
// weights: by the cosine at which the surface is seen over the squared distance.
// Hidden is what lies farther than the view's depth there by more than the tolerance.
void ColorPoints(const std::vector<DepthView>& views, std::span<const std::uint8_t* const> images,
                 std::int64_t count, const double* points, double tolerance, float* colors) {
  ParallelFor(count, kPointBatch, [&](std::int64_t begin, std::int64_t end) {
    PointBatch batch;
    ViewedBatch seen;
    const int size = static_cast<int>(end - begin);
    std::vector<float> sums(4 * static_cast<std::size_t>(size), 0.0f);
    for (int i = 0; i < size; ++i) {
      const double* point = points + 3 * (begin + i);
      batch.x[i] = static_cast<float>(point[0]);
      batch.y[i] = static_cast<float>(point[1]);
      batch.z[i] = static_cast<float>(point[2]);
    }
    for (std::size_t k = 0; k < views.size(); ++k) {
      if (images[k] == nullptr) continue;
      ProjectSome(views[k], size, &batch, &seen);
      for (int i = 0; i < size; ++i) {
        DepthSample sample;
        if (!views[k].Sample(seen.u[i], seen.v[i], &sample)) continue;
        const float distance = seen.distance[i];
        if (sample.depth > DepthSample::kFree) continue;
        if (!(distance <= sample.depth + static_cast<float>(tolerance))) continue;
        const float weight = sample.weight * sample.cosine / (distance * distance);
        float* sum = &sums[4 * static_cast<std::size_t>(i)];
        AddColor(views[k], images[k], seen.u[i], seen.v[i], weight, sum);
        sum[3] += weight;
      }
    }
    for (int i = 0; i < size; ++i) {
      const float* sum = &sums[4 * static_cast<std::size_t>(i)];
      for (int c = 0; c < 3; ++c) {
        colors[3 * (begin + i) + c] =
            sum[3] > 0.0f ? sum[c] / sum[3] : std::numeric_limits<float>::quiet_NaN();
      }
    }
  });
}

}  // namespace gsut
