// Balanced k-d tree with small leaves; built once, asked once for each point.
#include "gsut/gaussians/seed_neighbors.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "gsut/base/parallel.h"

namespace gsut {
namespace {

using Point = std::array<double, 3>;

// Points of a leaf, which are compared one by one: fewer would make more nodes to walk.
constexpr std::int64_t kLeafPoints = 12;
// Points lie in one line if their squares across it are no more than rounding beside those along
// it.
constexpr double kLeastSpread = 1e-12;

// The nearest so far, ascending: squared distances, and places in the tree's order.
struct Nearest {
  std::array<double, kPlaneNeighbors> squares;
  std::array<std::int64_t, kPlaneNeighbors> places;
  Nearest() { squares.fill(std::numeric_limits<double>::infinity()); }
  double Worst() const { return squares.back(); }
  void Insert(double square, std::int64_t place) {
    if (!(square < squares.back())) return;
    int i = kPlaneNeighbors - 1;
    for (; i > 0 && squares[i - 1] > square; --i) {
      squares[i] = squares[i - 1];
      places[i] = places[i - 1];
    }
    squares[i] = square;
    places[i] = place;
  }
};

// A node covers a range of `order`; its halves are [begin, middle) and [middle, end). The tree
// needs no node storage but the split: ranges follow from halving.
class Tree {
 public:
  Tree(const double* points, std::int64_t count) : points_(points), order_(count) {
    for (std::int64_t i = 0; i < count; ++i) order_[i] = i;
    std::int64_t nodes = 1;
    for (std::int64_t size = count; size > kLeafPoints; size = (size + 1) / 2)
      nodes = 2 * nodes + 1;
    splits_.resize(nodes);
    // The upper levels one after the other, then their subtrees side by side.
    std::vector<Range> level = {{0, 0, count}};
    for (int depth = 0; depth < kSerialLevels; ++depth) {
      std::vector<Range> next;
      for (const Range& range : level) {
        if (range.end - range.begin <= kLeafPoints) continue;
        const std::int64_t middle = SplitNode(range);
        next.push_back({2 * range.node + 1, range.begin, middle});
        next.push_back({2 * range.node + 2, middle, range.end});
      }
      level = std::move(next);
    }
    ParallelFor(static_cast<std::int64_t>(level.size()), 1,
                [&](std::int64_t begin, std::int64_t end) {
                  for (std::int64_t i = begin; i < end; ++i) Build(level[i]);
                });
    for (std::int64_t i = 0; i < count; ++i) {
      const double* p = points + 3 * order_[i];
      sorted_.push_back({p[0], p[1], p[2]});
    }
  }

  // The point's rank in the tree's order, by position i of that order.
  std::int64_t Original(std::int64_t i) const { return order_[i]; }
  Eigen::Map<const Eigen::Vector3d> At(std::int64_t i) const {
    return Eigen::Map<const Eigen::Vector3d>(sorted_[i].data());
  }

  Nearest Query(std::int64_t i) const {
    Nearest nearest;
    Visit({0, 0, static_cast<std::int64_t>(sorted_.size())}, i, &nearest);
    return nearest;
  }

 private:
  static constexpr int kSerialLevels = 5;
  struct Range {
    std::int64_t node, begin, end;
  };
  struct SplitPlane {
    int axis;
    double value;
  };

  // Splits at the median of the axis in which the points spread most.
  std::int64_t SplitNode(const Range& range) {
    Point low, high;
    low.fill(std::numeric_limits<double>::infinity());
    high.fill(-std::numeric_limits<double>::infinity());
    for (std::int64_t i = range.begin; i < range.end; ++i) {
      for (int axis = 0; axis < 3; ++axis) {
        const double value = points_[3 * order_[i] + axis];
        low[axis] = std::min(low[axis], value);
        high[axis] = std::max(high[axis], value);
      }
    }
    int axis = 0;
    for (int other = 1; other < 3; ++other) {
      if (high[other] - low[other] > high[axis] - low[axis]) axis = other;
    }
    const std::int64_t middle = range.begin + (range.end - range.begin + 1) / 2;
    const auto key = [&](std::int64_t point) { return points_[3 * point + axis]; };
    std::nth_element(
        order_.begin() + range.begin, order_.begin() + middle, order_.begin() + range.end,
        [&](std::int64_t a, std::int64_t b) { return key(a) != key(b) ? key(a) < key(b) : a < b; });
    splits_[range.node] = {axis, key(order_[middle])};
    return middle;
  }

  // Splits a range down to its leaves; ranges of siblings share no point, so that they may be built
  // on any threads.
  void Build(const Range& range) {
    if (range.end - range.begin <= kLeafPoints) return;
    const std::int64_t middle = SplitNode(range);
    Build({2 * range.node + 1, range.begin, middle});
    Build({2 * range.node + 2, middle, range.end});
  }

  void Visit(const Range& range, std::int64_t self, Nearest* nearest) const {
    const Point& p = sorted_[self];
    if (range.end - range.begin <= kLeafPoints) {
      for (std::int64_t i = range.begin; i < range.end; ++i) {
        if (i == self) continue;
        const double x = sorted_[i][0] - p[0], y = sorted_[i][1] - p[1], z = sorted_[i][2] - p[2];
        nearest->Insert(x * x + y * y + z * z, i);
      }
      return;
    }
    const std::int64_t middle = range.begin + (range.end - range.begin + 1) / 2;
    const SplitPlane& split = splits_[range.node];
    const Range low = {2 * range.node + 1, range.begin, middle};
    const Range high = {2 * range.node + 2, middle, range.end};
    const double offset = p[split.axis] - split.value;
    // The side that holds the point first; the other only if the plane is nearer than the worst so
    // far.
    Visit(offset < 0.0 ? low : high, self, nearest);
    if (offset * offset < nearest->Worst()) Visit(offset < 0.0 ? high : low, self, nearest);
  }

  const double* points_;
  std::vector<std::int64_t> order_;
  std::vector<SplitPlane> splits_;
  std::vector<Point> sorted_;
};

// Lays the plane through a point and its nearest others.
void LayPlane(const Tree& tree, std::int64_t self, const Nearest& nearest, Neighborhood* found) {
  Eigen::Matrix<double, 3, kPlaneNeighbors + 1> offsets;
  for (int k = 0; k < kPlaneNeighbors; ++k) {
    offsets.col(k) = tree.At(nearest.places[k]) - tree.At(self);
  }
  offsets.col(kPlaneNeighbors).setZero();
  const Eigen::Vector3d mean = offsets.rowwise().mean();
  offsets.colwise() -= mean;
  const Eigen::Matrix3d spread = offsets * offsets.transpose();
  // Principal axes: the normal is that of the least spread, the frame right-handed.
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(spread);
  const Eigen::Vector3d& squares = solver.eigenvalues();  // ascending
  if (!(squares[1] > kLeastSpread * squares[2])) return;
  Eigen::Matrix3d axes;
  axes.col(2) = solver.eigenvectors().col(0);
  axes.col(0) = solver.eigenvectors().col(2);
  axes.col(1) = axes.col(2).cross(axes.col(0));
  found->frame = Eigen::Quaterniond(axes);
  found->thickness = std::sqrt(std::max(squares[0], 0.0) / squares[1]);
}

}  // namespace

std::vector<Neighborhood> FindNeighborhoods(const double* points, std::int64_t count) {
  std::vector<Neighborhood> result(count);
  if (count < 2) return result;
  const Tree tree(points, count);
  const std::int64_t neighbors = std::min<std::int64_t>(kSeedNeighbors, count - 1);
  constexpr std::int64_t kChunkPoints = 256;
  ParallelFor(count, kChunkPoints, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const Nearest nearest = tree.Query(i);
      Neighborhood& found = result[tree.Original(i)];
      for (std::int64_t k = 0; k < neighbors; ++k) found.distance += std::sqrt(nearest.squares[k]);
      found.distance /= static_cast<double>(neighbors);
      if (count > kPlaneNeighbors) LayPlane(tree, i, nearest, &found);
    }
  });
  return result;
}

}  // namespace gsut
