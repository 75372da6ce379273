// Schur complements: each body's rows are made by one thread, point by point. Products of small
// matrices are lazy: Eigen's blocked product is no faster for them, and takes seconds to compile.
#include "gsut/sfm/eliminate_points.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <utility>

#include "gsut/base/parallel.h"
#include "gsut/sfm/dense.h"

namespace gsut {
namespace {

constexpr std::int64_t kEliminationGrain = 64;  // points of a chunk of parallel work
// A direction of a point whose square counts less than this share is open: parallax below 1e-6 rad.
constexpr double kOpen = 1e-12;
// Square of a pivot of the scaled equations below which bodies do not hold together.
constexpr double kWeak = 1e-12;

using MatrixX3 = Eigen::Matrix<double, Eigen::Dynamic, 3>;

// A point's share of what is subtracted.
struct PointShare {
  Eigen::Matrix3d inverse = Eigen::Matrix3d::Zero();  // of its own block
  MatrixX3 shared;                                    // sum of by_shared^T by_point
  int rank = 0;
};

// Inverts a point's block where it is determined; elsewhere the inverse is 0.
void Invert(const Eigen::Matrix3d& normal, PointShare* share) {
  const double scale = normal.trace() / 3;
  if (normal.determinant() > kOpen * scale * scale * scale) {
    share->inverse = normal.inverse();
    share->rank = 3;
    return;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(normal);
  for (int k = 0; k < 3; ++k) {
    const double value = solver.eigenvalues()[k];
    if (!(value > kOpen * solver.eigenvalues()[2])) continue;
    const Eigen::Vector3d axis = solver.eigenvectors().col(k);
    share->inverse += axis * axis.transpose() / value;
    ++share->rank;
  }
}

// Also sets `cross` of all observations.
std::vector<PointShare> InvertPoints(ObservationTable* table, int shared) {
  const auto count = static_cast<std::int64_t>(table->of_point.size());
  std::vector<PointShare> shares(count);
  ParallelFor(count, kEliminationGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t point = begin; point < end; ++point) {
      if (table->of_point[point].empty()) continue;
      Eigen::Matrix3d by_point = Eigen::Matrix3d::Zero();
      shares[point].shared = MatrixX3::Zero(shared, 3);
      for (const int i : table->of_point[point]) {
        ObservationDerivatives& linear = table->linear[i];
        by_point += linear.by_point.transpose() * linear.by_point;
        linear.cross = linear.by_body.transpose().lazyProduct(linear.by_point);
        if (shared > 0) {
          shares[point].shared += linear.by_shared.transpose().lazyProduct(linear.by_point);
        }
      }
      Invert(by_point, &shares[point]);
    }
  });
  return shares;
}

// What a body sees of a point.
struct Group {
  int point;
  std::vector<int> own;
};

std::vector<std::vector<Group>> GroupByBody(const ObservationTable& table, int bodies) {
  std::vector<std::vector<Group>> of_body(bodies);
  for (std::size_t point = 0; point < table.of_point.size(); ++point) {
    for (const int i : table.of_point[point]) {
      std::vector<Group>& groups = of_body[table.linear[i].body];
      if (groups.empty() || groups.back().point != static_cast<int>(point)) {
        groups.push_back({static_cast<int>(point), {}});
      }
      groups.back().own.push_back(i);
    }
  }
  return of_body;
}

// The shared unknowns' own block.
void AddShared(const ObservationTable& table, const std::vector<PointShare>& shares,
               Eigen::Ref<Eigen::MatrixXd> block) {
  // In order, for the same bits on any number of threads; there are few shared unknowns.
  for (const ObservationDerivatives& linear : table.linear) {
    block += linear.by_shared.transpose().lazyProduct(linear.by_shared);
  }
  for (const PointShare& share : shares) {
    if (share.rank == 0) continue;
    const MatrixX3 scaled = share.shared.lazyProduct(share.inverse);
    block -= scaled.lazyProduct(share.shared.transpose());
  }
}

}  // namespace

EliminatedPoints EliminatePoints(ObservationTable table, int bodies, int size, int shared) {
  const std::vector<PointShare> shares = InvertPoints(&table, shared);
  // No two bodies share a row: threads never change the same number.
  const std::vector<ObservationDerivatives>& linear = table.linear;
  const std::vector<std::vector<Group>> of_body = GroupByBody(table, bodies);
  EliminatedPoints result;
  for (const PointShare& share : shares) result.determined += share.rank;
  const int end = size * bodies;
  result.normal = Eigen::MatrixXd::Zero(end + shared, end + shared);
  Eigen::MatrixXd& normal = result.normal;
  ParallelFor(bodies, 1, [&](std::int64_t begin, std::int64_t) {
    const int body = bodies - 1 - static_cast<int>(begin);  // the longest rows first
    for (const Group& group : of_body[body]) {
      const PointShare& share = shares[group.point];
      for (const int i : group.own) {
        normal.block(size * body, size * body, size, size) +=
            linear[i].by_body.transpose().lazyProduct(linear[i].by_body);
      }
      // The point's unknowns go: what it ties together is subtracted.
      for (const int i : group.own) {
        const MatrixX3 scaled = linear[i].cross.lazyProduct(share.inverse);
        for (const int j : table.of_point[group.point]) {
          if (linear[j].body > body) continue;
          normal.block(size * body, size * linear[j].body, size, size) -=
              scaled.lazyProduct(linear[j].cross.transpose());
        }
        if (shared == 0) continue;
        normal.block(end, size * body, shared, size) +=
            linear[i].by_shared.transpose().lazyProduct(linear[i].by_body) -
            share.shared.lazyProduct(scaled.transpose());
      }
    }
  });
  if (shared > 0) AddShared(table, shares, normal.bottomRightCorner(shared, shared));
  return result;
}

SharedInformation FindSharedInformation(ObservationTable table, int bodies,
                                        const Eigen::VectorXd& prior, const std::vector<int>& held,
                                        int shared) {
  const int size = static_cast<int>(prior.size());
  const auto observations = static_cast<std::int64_t>(table.linear.size());
  EliminatedPoints left = EliminatePoints(std::move(table), bodies, size, shared);
  // What the gauge holds is left out; of the others the prior is known beforehand.
  std::vector<std::uint8_t> is_held(size * bodies, 0);
  for (const int unknown : held) is_held[unknown] = 1;
  std::vector<int> free;
  for (int unknown = 0; unknown < size * bodies; ++unknown) {
    left.normal(unknown, unknown) += prior[unknown % size];
    if (!is_held[unknown]) free.push_back(unknown);
  }
  // Scaled to a diagonal of ones; [A; B] are the free unknowns' columns, lower triangle.
  const auto count = static_cast<Eigen::Index>(free.size());
  Eigen::VectorXd length(count);
  for (Eigen::Index k = 0; k < count; ++k) {
    length[k] = 1 / std::sqrt(std::max(left.normal(free[k], free[k]), 1e-300));
  }
  Eigen::MatrixXd bodies_own(count, count), tied(count, shared);
  for (Eigen::Index column = 0; column < count; ++column) {
    for (Eigen::Index row = column; row < count; ++row) {
      bodies_own(row, column) = left.normal(free[row], free[column]) * length[row] * length[column];
    }
    tied.row(column) = left.normal.col(free[column]).tail(shared).transpose() * length[column];
  }
  // In place: the factor takes the memory of the equations.
  const bool is_weak = !FactorizeCholesky(bodies_own) ||
                       (count > 0 && bodies_own.diagonal().cwiseAbs2().minCoeff() < kWeak);
  if (is_weak) return {Eigen::MatrixXd::Zero(shared, shared), 2 * observations};
  // Schur complement of the bodies: with A = L L^T, B A^-1 B^T = (L^-1 B^T)^T (L^-1 B^T).
  SolveLower(bodies_own, tied);
  SharedInformation result{left.normal.bottomRightCorner(shared, shared),
                           left.determined + static_cast<std::int64_t>(count)};
  result.normal -= MultiplyByTranspose(tied);
  return result;
}

}  // namespace gsut
