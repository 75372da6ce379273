// Conjugate gradients on the reduced system, which is never formed. Products of small matrices are
// lazy: Eigen's blocked product is no faster for them, and takes seconds to compile for each.
#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "gsut/base/parallel.h"
#include "gsut/sfm/dense.h"
#include "gsut/sfm/reduced_system.h"

namespace gsut {
namespace {

// S x = (B^T B + D) x - B^T P ((P^T P + D)^-1 (P^T B x)): as many multiplications as there are
// entries, where a factorisation takes the cube of the number of blocks. Steps are few because of
// the preconditioner, which adds up two inexact inverses:
//   1. Of clusters of blocks, each by itself: what is near.
//   2. Of one coarse system: shared blocks move freely, clusters as rigid bodies of any size (the
//      columns of Motions: no residual changes if all clusters move alike). Without it there would
//      be as many steps as clusters on the longest way between two.
// It is that of domain decomposition (Toselli and Widlund, "Domain decomposition methods", 2005,
// section 2.2) with a coarse space of aggregates (Vanek, Mandel and Brezina, "Algebraic multigrid
// by smoothed aggregation", 1996).

// Share of the step's length, in the norm of the system, that may be missing.
constexpr double kResidual = 1e-3;
constexpr int kMostSteps = 300;
// A motion of a cluster that the others make up to this share of its length is none.
constexpr double kIndependent = 1e-6;
constexpr std::int64_t kProductGrain = 256;
constexpr std::int64_t kBlockGrain = 4;

using MatrixX3 = Eigen::Matrix<double, Eigen::Dynamic, 3>;

// Products of an entry (size, 3), of the sizes that poses have, without and with a velocity.
template <int kSize>
Eigen::Vector3d TimesVector(const double* entry, const double* x) {
  return Eigen::Map<const Eigen::Matrix<double, kSize, 3>>(entry).transpose() *
         Eigen::Map<const Eigen::Matrix<double, kSize, 1>>(x);
}

template <int kSize>
void Subtract(const double* entry, const Eigen::Vector3d& by, double* y) {
  Eigen::Map<Eigen::Matrix<double, kSize, 1>>(y).noalias() -=
      Eigen::Map<const Eigen::Matrix<double, kSize, 3>>(entry) * by;
}

Eigen::Vector3d TimesVector(const double* entry, const double* x, int size) {
  if (size == 6) return TimesVector<6>(entry, x);
  if (size == 12) return TimesVector<12>(entry, x);
  return Eigen::Map<const MatrixX3>(entry, size, 3).transpose() *
         Eigen::Map<const Eigen::VectorXd>(x, size);
}

void Subtract(const double* entry, const Eigen::Vector3d& by, double* y, int size) {
  if (size == 6) return Subtract<6>(entry, by, y);
  if (size == 12) return Subtract<12>(entry, by, y);
  Eigen::Map<Eigen::VectorXd>(y, size) -= Eigen::Map<const MatrixX3>(entry, size, 3) * by;
}

}  // namespace

void ReducedSystem::Multiply(const Eigen::VectorXd& x, Eigen::VectorXd* y) {
  ParallelFor(num_points_, kProductGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t point = begin; point < end; ++point) {
      Eigen::Vector3d sum = Eigen::Vector3d::Zero();
      for (std::size_t e = first_entry_[point]; e < first_entry_[point + 1]; ++e) {
        const int block = entries_[e].block;
        if (block >= num_ordered_) continue;
        sum += TimesVector(&cross_[entries_[e].at], &x[start_[block]], sizes_[block]);
      }
      point_steps_[point] = inverse_[point] * sum;
    }
  });
  const Eigen::Index shared = shared_.rows();
  ParallelFor(num_ordered_, kBlockGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t block = begin; block < end; ++block) {
      const int start = start_[block], size = sizes_[block];
      auto out = y->segment(start, size);
      out.noalias() = own_[block] * x.segment(start, size);
      out.noalias() += shared_.middleCols(start, size).transpose() * x.tail(shared);
      for (const int e : entries_of_block_[block]) {
        Subtract(&cross_[entries_[e].at], point_steps_[entries_[e].point], &(*y)[start], size);
      }
    }
  });
  y->tail(shared).noalias() = shared_ * x;
}

// Bases of the clusters' motions, and which points each sees.
void ReducedSystem::ListClusters() {
  const int clusters = matrix_->num_tiles();
  std::vector<std::vector<int>> blocks(clusters);
  for (int block = 0; block < num_ordered_; ++block) blocks[tile_[block]].push_back(block);
  basis_.resize(num_ordered_);
  cluster_start_.assign(1, 0);
  for (int cluster = 0; cluster < clusters; ++cluster) {
    const Eigen::Index columns = motions_[blocks[cluster].front()].cols();
    Eigen::Index rank = 0;
    Eigen::MatrixXd found(rows_of_tile_[cluster], 0);
    if (columns > 0) {
      Eigen::MatrixXd all(rows_of_tile_[cluster], columns);
      for (const int block : blocks[cluster]) {
        all.middleRows(in_tile_[block], sizes_[block]) = motions_[block];
      }
      Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr;
      qr.setThreshold(kIndependent);
      qr.compute(all);
      rank = qr.rank();
      // The first columns of Q. Eigen's own Q, of any size and blocked, takes long to compile.
      found = Eigen::MatrixXd::Identity(all.rows(), rank);
      Eigen::VectorXd workspace(rank);
      for (Eigen::Index k = rank - 1; k >= 0; --k) {
        found.bottomRows(all.rows() - k)
            .applyHouseholderOnTheLeft(qr.matrixQR().col(k).tail(all.rows() - k - 1),
                                       qr.hCoeffs()[k], workspace.data());
      }
    }
    for (const int block : blocks[cluster]) {
      basis_[block] = found.middleRows(in_tile_[block], sizes_[block]);
      for (int k = 0; k < sizes_[block]; ++k) {
        if (held_[block][k]) basis_[block].row(k).setZero();  // exactly
      }
    }
    cluster_start_.push_back(cluster_start_.back() + static_cast<int>(rank));
  }
  entries_of_cluster_.resize(clusters);
  first_cluster_entry_.assign(1, 0);
  std::size_t at = 0;
  for (int point = 0; point < num_points_; ++point) {
    const std::size_t first = cluster_entries_.size();
    for (std::size_t e = first_entry_[point]; e < first_entry_[point + 1]; ++e) {
      if (entries_[e].block >= num_ordered_) continue;
      const int cluster = tile_[entries_[e].block];
      std::size_t found = first;
      while (found < cluster_entries_.size() && cluster_entries_[found].cluster != cluster) ++found;
      if (found < cluster_entries_.size()) continue;
      entries_of_cluster_[cluster].push_back(static_cast<int>(found));
      cluster_entries_.push_back({point, cluster, at});
      at += 3 * static_cast<std::size_t>(cluster_start_[cluster + 1] - cluster_start_[cluster]);
    }
    first_cluster_entry_.push_back(cluster_entries_.size());
  }
  cluster_cross_.resize(at);
}

// The coarse system: S between the motions of clusters and shared blocks, made as S is.
bool ReducedSystem::FactorizeClusters() {
  const auto columns_of = [&](int cluster) {
    return cluster_start_[cluster + 1] - cluster_start_[cluster];
  };
  std::fill(cluster_cross_.begin(), cluster_cross_.end(), 0.0);
  ParallelFor(num_points_, kProductGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t point = begin; point < end; ++point) {
      for (std::size_t e = first_entry_[point]; e < first_entry_[point + 1]; ++e) {
        const int block = entries_[e].block;
        if (block >= num_ordered_) continue;
        std::size_t at = first_cluster_entry_[point];
        while (cluster_entries_[at].cluster != tile_[block]) ++at;
        Eigen::Map<MatrixX3>(&cluster_cross_[cluster_entries_[at].at], columns_of(tile_[block]), 3)
            .noalias() += basis_[block].transpose().lazyProduct(
            Eigen::Map<const MatrixX3>(&cross_[entries_[e].at], sizes_[block], 3));
      }
    }
  });
  const int clusters = matrix_->num_tiles(), moving = cluster_start_.back();
  const Eigen::Index shared = shared_.rows();
  coarse_.setZero(moving + shared, moving + shared);
  ParallelFor(clusters, 1, [&](std::int64_t cluster, std::int64_t) {
    const int own = static_cast<int>(cluster), start = cluster_start_[own], size = columns_of(own);
    for (const int index : entries_of_cluster_[own]) {
      const int point = cluster_entries_[index].point;
      const MatrixX3 scaled =
          Eigen::Map<const MatrixX3>(&cluster_cross_[cluster_entries_[index].at], size, 3) *
          inverse_[point];
      for (std::size_t e = first_cluster_entry_[point]; e < first_cluster_entry_[point + 1]; ++e) {
        const int other = cluster_entries_[e].cluster;
        if (other > own) continue;
        const Eigen::Map<const MatrixX3> cross(&cluster_cross_[cluster_entries_[e].at],
                                               columns_of(other), 3);
        coarse_.block(start, cluster_start_[other], size, columns_of(other)).noalias() -=
            scaled.lazyProduct(cross.transpose());
      }
    }
  });
  for (int block = 0; block < num_ordered_; ++block) {
    const int start = cluster_start_[tile_[block]], size = columns_of(tile_[block]);
    const Eigen::MatrixXd scaled = own_[block].lazyProduct(basis_[block]);
    coarse_.block(start, start, size, size) += basis_[block].transpose().lazyProduct(scaled);
    coarse_.block(moving, start, shared, size) +=
        shared_.middleCols(start_[block], sizes_[block]).lazyProduct(basis_[block]);
  }
  auto corner = shared_.rightCols(shared);
  corner.triangularView<Eigen::StrictlyUpper>() = corner.transpose();
  coarse_.bottomRightCorner(shared, shared) = corner;
  return FactorizeCholesky(coarse_);
}

Eigen::VectorXd ReducedSystem::Precondition(const Eigen::VectorXd& residual) const {
  const Eigen::Index shared = shared_.rows();
  Eigen::VectorXd coarse = Eigen::VectorXd::Zero(cluster_start_.back() + shared);
  const auto motion = [&](int block) {
    return coarse.segment(cluster_start_[tile_[block]], basis_[block].cols());
  };
  for (int block = 0; block < num_ordered_; ++block) {
    motion(block) += basis_[block].transpose() * residual.segment(start_[block], sizes_[block]);
  }
  coarse.tail(shared) = residual.tail(shared);
  SolveCholesky(coarse_, coarse);
  Eigen::VectorXd near = residual.head(residual.size() - shared);
  matrix_->Solve(&near);
  Eigen::VectorXd found(residual.size());
  found << near, coarse.tail(shared);
  for (int block = 0; block < num_ordered_; ++block) {
    found.segment(start_[block], sizes_[block]) += basis_[block] * motion(block);
  }
  return found;
}

bool ReducedSystem::SolveIteratively() {
  if (cluster_start_.empty()) ListClusters();
  if (!FactorizeClusters()) return false;
  Eigen::VectorXd residual = step_, moved(step_.size());
  step_.setZero();
  Eigen::VectorXd found = Precondition(residual), direction = found;
  double square = residual.dot(found);
  const double enough = kResidual * kResidual * square;
  for (int steps = 0; steps < kMostSteps && square > enough; ++steps) {
    Multiply(direction, &moved);
    const double curvature = direction.dot(moved);
    if (!(curvature > 0.0)) return steps > 0;  // not positive definite
    const double length = square / curvature;
    step_ += length * direction;
    residual -= length * moved;
    found = Precondition(residual);
    const double next = residual.dot(found);
    direction = found + (next / square) * direction;
    square = next;
  }
  return true;
}

}  // namespace gsut
