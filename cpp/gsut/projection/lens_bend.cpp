// Bounds the lens' derivatives over patches of the sphere, on the faces of a cube.
#include "gsut/projection/lens_bend.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <list>
#include <mutex>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

using Eigen::Vector3d;

constexpr int kPatches = 32;  // along a face's edge; 2.8 degrees and less
constexpr int kCells = LensBend::kCells;
constexpr int kFaces = LensBend::kFaces;
constexpr int kLevels = LensBend::kLevels;
constexpr double kCellRadius = 0.0885;   // radians from a cell's middle to its corner, at most
constexpr double kPatchRadius = 0.0445;  // the same of a patch
constexpr std::size_t kKept = 16;

// The middle of place k of `count` along a face's edge, in [-1, 1].
double Place(std::int64_t k, int count) {
  return (2.0 * static_cast<double>(k) + 1.0) / count - 1.0;
}

Vector3d FaceDirection(int face, double x, double y) {
  Vector3d point;
  FacePoint(face, x, y, point.data());
  return point.normalized();
}

}  // namespace

LensBend::LensBend(const Camera& camera) {
  constexpr int kNumPatches = kFaces * kPatches * kPatches;
  std::vector<Vector3d> directions(kNumPatches);
  std::vector<Bend> bends(kNumPatches);
  ParallelFor(kNumPatches, 64, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const int face = static_cast<int>(i / (kPatches * kPatches));
      const std::size_t j = static_cast<std::size_t>(i);
      const std::int64_t column = i % kPatches, row = i / kPatches % kPatches;
      directions[j] = FaceDirection(face, Place(column, kPatches), Place(row, kPatches));
      // What lies beyond the domain needs no look.
      constexpr float kNone = std::numeric_limits<float>::infinity();
      const double angle = std::acos(std::clamp(directions[j][2], -1.0, 1.0));
      bends[j] = {kNone, kNone, kNone};
      if (angle - kPatchRadius > camera.MaxAngle()) continue;
      const auto edge = [](std::int64_t k) {
        return 2.0 * static_cast<double>(k) / kPatches - 1.0;
      };
      bends[j] =
          BoundBend(camera, face, {edge(column), edge(column + 1)}, {edge(row), edge(row + 1)});
    }
  });
  constexpr int kNumCells = kFaces * kCells * kCells;
  table_.assign(static_cast<std::size_t>(kLevels) * kNumCells, Bend{0.0f, 0.0f, 0.0f});
  std::array<double, kLevels> cosines;
  for (std::size_t level = 0; level < kLevels; ++level) {
    cosines[level] = std::cos(std::asin(kSines[level]) + kCellRadius + kPatchRadius);
  }
  ParallelFor(kNumCells, 16, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t cell = begin; cell < end; ++cell) {
      const Vector3d center =
          FaceDirection(static_cast<int>(cell / (kCells * kCells)), Place(cell % kCells, kCells),
                        Place(cell / kCells % kCells, kCells));
      for (std::size_t i = 0; i < directions.size(); ++i) {
        const double cosine = center.dot(directions[i]);
        for (std::size_t level = 0; level < kLevels; ++level) {
          if (cosine < cosines[level]) continue;
          Bend& bend = table_[level * kNumCells + static_cast<std::size_t>(cell)];
          bend.first = std::max(bend.first, bends[i].first);
          bend.second = std::max(bend.second, bends[i].second);
          bend.third = std::max(bend.third, bends[i].third);
        }
      }
    }
  });
}

Bend LensBend::At(const double mean[3], double sine) const {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  if (!(sine < kLargestSine)) return {kInfinity, kInfinity, kInfinity};
  int level = 0;
  while (!(sine < kSines[level])) ++level;
  const double ax = std::abs(mean[0]), ay = std::abs(mean[1]), az = std::abs(mean[2]);
  int face;
  double x, y, largest;
  if (ax >= ay && ax >= az) {
    face = mean[0] < 0.0 ? 1 : 0;
    x = mean[1];
    y = mean[2];
    largest = ax;
  } else if (ay >= az) {
    face = mean[1] < 0.0 ? 3 : 2;
    x = mean[0];
    y = mean[2];
    largest = ay;
  } else {
    face = mean[2] < 0.0 ? 5 : 4;
    x = mean[0];
    y = mean[1];
    largest = az;
  }
  const auto cell = [largest](double value) {
    const int k = static_cast<int>((value / largest + 1.0) * (0.5 * kCells));
    return std::clamp(k, 0, kCells - 1);
  };
  const int index = ((level * kFaces + face) * kCells + cell(y)) * kCells + cell(x);
  return table_[static_cast<std::size_t>(index)];
}

std::shared_ptr<const LensBend> BendOf(const Camera& camera) {
  struct Kept {
    Camera camera;
    std::shared_ptr<const LensBend> bend;
  };
  static std::mutex mutex;
  static std::list<Kept> kept;
  const std::lock_guard<std::mutex> lock(mutex);
  for (auto entry = kept.begin(); entry != kept.end(); ++entry) {
    if (entry->camera == camera) {
      kept.splice(kept.begin(), kept, entry);
      return entry->bend;
    }
  }
  // A copy with an image of its own: it must not keep the ray table alive.
  kept.push_front(
      {camera.Resized(camera.width(), camera.height()), std::make_shared<const LensBend>(camera)});
  if (kept.size() > kKept) kept.pop_back();
  return kept.front().bend;
}

}  // namespace gsut
