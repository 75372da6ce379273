// Balanced median splits, one level after another, the nodes of a level in parallel.
#include "gsut/optimize/blocks.h"

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <utility>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

using Row = std::uint32_t;

Eigen::Vector3d Point(const float* points, Row row) {
  const float* p = points + 3 * static_cast<std::size_t>(row);
  return Eigen::Vector3d(p[0], p[1], p[2]);
}

// Direction of the largest spread, pointing to where the points' third moment is positive.
// (An eigenvector has no sign of its own: the third moment gives one that turns with the points.)
Eigen::Vector3d PrincipalDirection(const float* points, const Row* rows, std::int64_t count) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (std::int64_t i = 0; i < count; ++i) mean += Point(points, rows[i]);
  mean /= static_cast<double>(count);
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (std::int64_t i = 0; i < count; ++i) {
    const Eigen::Vector3d p = Point(points, rows[i]) - mean;
    spread += p * p.transpose();
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(spread);
  Eigen::Vector3d direction = solver.eigenvectors().col(2);
  double skew = 0.0;
  for (std::int64_t i = 0; i < count; ++i) {
    const double t = direction.dot(Point(points, rows[i]) - mean);
    skew += t * t * t;
  }
  if (skew < 0.0) direction = -direction;
  return direction;
}

}  // namespace

Blocks SplitIntoBlocks(const float* points, const std::vector<Row>& rows, int depth,
                       BlockAxis axis) {
  Blocks blocks;
  blocks.order = rows;
  blocks.begin = {0, static_cast<std::int64_t>(rows.size())};
  std::vector<std::pair<double, Row>> keys(rows.size());
  for (int level = 0; level < depth && std::int64_t{2} << level <= blocks.begin.back(); ++level) {
    // Each node of the level is halved at the median of its projections: 2^depth blocks whose sizes
    // differ by one.
    std::vector<std::int64_t> next(2 * static_cast<std::size_t>(blocks.size()) + 1);
    next.back() = blocks.begin.back();
    ParallelFor(blocks.size(), 1, [&](std::int64_t node, std::int64_t) {
      const auto at = static_cast<std::size_t>(node);
      const std::int64_t begin = blocks.begin[at], end = blocks.begin[at + 1];
      const std::int64_t middle = begin + (end - begin) / 2;
      Row* order = blocks.order.data();
      const Eigen::Vector3d direction =
          axis == BlockAxis::kCycle ? Eigen::Vector3d(Eigen::Vector3d::Unit(level % 3))
                                    : PrincipalDirection(points, order + begin, end - begin);
      // Ties of equal positions are broken by row, so that the halves do not depend on the order.
      for (std::int64_t i = begin; i < end; ++i) {
        keys[static_cast<std::size_t>(i)] = {direction.dot(Point(points, order[i])), order[i]};
      }
      std::nth_element(keys.begin() + begin, keys.begin() + middle, keys.begin() + end);
      for (std::int64_t i = begin; i < end; ++i)
        order[i] = keys[static_cast<std::size_t>(i)].second;
      std::sort(order + begin, order + middle);  // one order, whatever nth_element left behind
      std::sort(order + middle, order + end);
      next[2 * at] = begin;
      next[2 * at + 1] = middle;
    });
    blocks.begin = std::move(next);
  }
  return blocks;
}

}  // namespace gsut
