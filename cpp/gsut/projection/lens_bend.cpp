// Samples the lens' second and third derivatives over the sphere, on the faces of a cube.
#include "gsut/projection/lens_bend.h"

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <list>
#include <mutex>

#include "gsut/base/parallel.h"
#include "gsut/cameras/lens_registry.h"

namespace gsut {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kSamples = 32;  // samples along a face's edge; 2.8 degrees and less
constexpr int kCells = LensBend::kCells;
constexpr int kFaces = LensBend::kFaces;
constexpr int kLevels = LensBend::kLevels;
constexpr double kCellRadius = 0.0885;  // from a cell's centre to its corner (radians)
constexpr double kGap = 0.045;          // from a sample to the middle between four
constexpr double kMargin = 1.2;
// Towards a pole of a panorama (sine of the angle to it) and the edge of a domain (radians) bends
// may grow without bound between two samples: they count as infinite this near.
constexpr double kPoleSine = 0.15;
constexpr double kEdge = 0.05;
constexpr double kStep = 1e-3;  // of differences: errors of 1e-6 (step squared) and 1e-7 (rounding)
constexpr std::size_t kKept = 16;

// Direction of the place (x, y) in [-1, 1]^2 of a face: +x, -x, +y, -y, +z, -z.
Vector3d FaceDirection(int face, double x, double y) {
  const double side = face % 2 == 0 ? 1.0 : -1.0;
  if (face < 2) return Vector3d(side, x, y).normalized();
  if (face < 4) return Vector3d(x, side, y).normalized();
  return Vector3d(x, y, side).normalized();
}

bool IsAtPole(const Camera& camera, const Vector3d& p) {
  return VisitLens(camera.lens(), [&](auto lens) {
    using Lens = decltype(lens);
    if constexpr (requires { Lens::PoleSine(1.0, 1.0, 1.0); }) {
      return Lens::PoleSine(p[0], p[1], p[2]) < kPoleSine;
    } else {
      return false;
    }
  });
}

// Largest bend of f at p from its exact Jacobian around p.
Bend BendAt(const Camera& camera, const Vector3d& p) {
  constexpr Bend kUnknown = {std::numeric_limits<float>::infinity(),
                             std::numeric_limits<float>::infinity()};
  using Jacobian = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
  bool valid = true;
  const auto jacobian = [&](const Vector3d& at) {
    double pixel[2];
    std::uint8_t ok = 0;
    Jacobian j;
    camera.ProjectJacobian(1, at.data(), pixel, &ok, j.data(), nullptr);
    valid = valid && ok && j.allFinite();
    return j;
  };
  const Jacobian middle = jacobian(p);
  if (!valid || IsAtPole(camera, p)) return kUnknown;
  const auto unit = [](int k) { return Vector3d(kStep * Vector3d::Unit(k)); };
  Matrix3d hessian[2];
  double third[2] = {0.0, 0.0};  // squared Frobenius norms
  for (int k = 0; k < 3; ++k) {
    const Jacobian plus = jacobian(p + unit(k)), minus = jacobian(p - unit(k));
    if (!valid) return kUnknown;
    for (int axis = 0; axis < 2; ++axis) {
      hessian[axis].row(k) = (plus.row(axis) - minus.row(axis)) / (2.0 * kStep);
      third[axis] += ((plus.row(axis) + minus.row(axis) - 2.0 * middle.row(axis)) / (kStep * kStep))
                         .squaredNorm();
    }
    for (int l = 0; l < k; ++l) {
      const Jacobian mixed = jacobian(p + unit(k) + unit(l)) + jacobian(p - unit(k) - unit(l)) -
                             jacobian(p + unit(k) - unit(l)) - jacobian(p - unit(k) + unit(l));
      if (!valid) return kUnknown;
      for (int axis = 0; axis < 2; ++axis) {
        third[axis] += 2.0 * (mixed.row(axis) / (4.0 * kStep * kStep)).squaredNorm();
      }
    }
  }
  double second = 0.0;
  for (const Matrix3d& h : hessian) {
    const Eigen::SelfAdjointEigenSolver<Matrix3d> solver(0.5 * (h + h.transpose()),
                                                         Eigen::EigenvaluesOnly);
    second = std::max(second, solver.eigenvalues().cwiseAbs().maxCoeff());
  }
  const double largest_third = std::sqrt(std::max(third[0], third[1]));
  return {static_cast<float>(kMargin * (second + kGap * largest_third)),
          static_cast<float>(kMargin * largest_third)};
}

}  // namespace

LensBend::LensBend(const Camera& camera) {
  constexpr int kNumSamples = kFaces * kSamples * kSamples;
  std::vector<Vector3d> directions(kNumSamples);
  std::vector<Bend> bends(kNumSamples);
  ParallelFor(kNumSamples, 64, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const auto place = [](std::int64_t k) {
        return (2.0 * static_cast<double>(k) + 1.0) / kSamples - 1.0;
      };
      const int face = static_cast<int>(i / (kSamples * kSamples));
      const std::size_t j = static_cast<std::size_t>(i);
      directions[j] = FaceDirection(face, place(i % kSamples), place(i / kSamples % kSamples));
      bends[j] = BendAt(camera, directions[j]);
    }
  });
  constexpr int kNumCells = kFaces * kCells * kCells;
  table_.assign(static_cast<std::size_t>(kLevels) * kNumCells, Bend{0.0f, 0.0f});
  std::array<double, kLevels> cosines, edge_cosines;
  for (std::size_t level = 0; level < kLevels; ++level) {
    const double radius = std::asin(kSines[level]) + kCellRadius + kGap;
    cosines[level] = std::cos(radius);
    edge_cosines[level] = std::cos(radius + kEdge);
  }
  ParallelFor(kNumCells, 16, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t cell = begin; cell < end; ++cell) {
      const auto place = [](std::int64_t k) {
        return (2.0 * static_cast<double>(k) + 1.0) / kCells - 1.0;
      };
      const Vector3d center = FaceDirection(static_cast<int>(cell / (kCells * kCells)),
                                            place(cell % kCells), place(cell / kCells % kCells));
      for (std::size_t i = 0; i < directions.size(); ++i) {
        const double cosine = center.dot(directions[i]);
        const auto& limits = std::isfinite(bends[i].second) ? cosines : edge_cosines;
        for (std::size_t level = 0; level < kLevels; ++level) {
          if (cosine < limits[level]) continue;
          Bend& bend = table_[level * kNumCells + static_cast<std::size_t>(cell)];
          bend.second = std::max(bend.second, bends[i].second);
          bend.third = std::max(bend.third, bends[i].third);
        }
      }
    }
  });
}

Bend LensBend::At(const double mean[3], double sine) const {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  if (!(sine < kLargestSine)) return {kInfinity, kInfinity};
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
