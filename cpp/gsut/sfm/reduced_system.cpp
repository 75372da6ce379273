// Points are eliminated each by itself; then each block's row of the rest is made by itself.
#include "gsut/sfm/reduced_system.h"

#include <hwy/cache_control.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "gsut/base/parallel.h"
#include "gsut/sfm/subtract_product.h"

namespace gsut {
namespace {

// The normal equations of bundle adjustment, with block unknowns b (poses, lenses), points p, the
// derivatives B and P of all observations r, and damping D:
//   [ B^T B + D   B^T P     ] [ db ]     [ B^T r ]
//   [ P^T B       P^T P + D ] [ dp ] = - [ P^T r ]
// P^T P is block-diagonal, 3 x 3 a point, as an observation sees one point. Eliminating points,
//   S db = -B^T r + W P^T r,   S = B^T B + D - W P^T B,   W = B^T P (P^T P + D)^-1,
// leaves the Schur complement S, which has a block for each two blocks with a common point: a band
// for a walk, dense for a turn around one object. Then dp = (P^T P + D)^-1 (-P^T r - P^T B db).
//
// Phases of a step, each sum by one thread in one order, so that bits do not depend on threads:
//   1. EliminatePoint: per point (P^T P + D)^-1 (inverse_), P^T r (point_gradient_) and, for each
//      block that sees it, B^T P (cross_).
//   2. FillRow: per block its row of S left of the diagonal and its right side, with W of one point
//      after the other: all of W would take as much memory as B^T P. The row of a shared block,
//      such as a lens, costs as much as those of many bodies, and is made in parts.
//   3. TiledCholesky: factorisation and db; or, where that takes too long, conjugate gradients.
//   4. dp, point by point.

// Points of a chunk of parallel work: some microseconds each.
constexpr std::int64_t kPointGrain = 64;
// Observations and points of a block whose values are fetched before they are needed: they lie
// apart, in the order of points.
constexpr std::size_t kAhead = 4;
// Observations of a chunk: a few dozen multiplications each.
constexpr std::int64_t kObservationGrain = 512;
// Least diagonal of an unknown, scaled to length one, that damping is taken of: without it an
// unknown that nothing sees would take any step.
constexpr double kLeastDiagonal = 1e-6;

// Makes SubtractProducts add.
const Eigen::Matrix2d kMinus = -Eigen::Matrix2d::Identity();

using RowMajor = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;
using Jacobian = Eigen::Map<const RowMajor>;
using MatrixX3 = Eigen::Matrix<double, Eigen::Dynamic, 3>;

// What an unknown's diagonal grows by: as if it was scaled to a length of about one.
double Damping(double diagonal, double radius) {
  const double length = 1.0 + std::sqrt(diagonal);
  return std::max(diagonal, kLeastDiagonal * length * length) / radius;
}

}  // namespace

ReducedSystem::ReducedSystem(std::vector<int> block_sizes, int num_ordered, int num_points,
                             const std::vector<Dependence>& observations, double most_work)
    : sizes_(std::move(block_sizes)),
      num_ordered_(num_ordered),
      num_points_(num_points),
      first_block_(1, 0),
      first_column_(1, 0),
      of_point_(num_points),
      parts_of_block_(sizes_.size()),
      by_point_(observations.size(), Eigen::Matrix<double, 2, 3>::Zero()),
      residuals_(observations.size()),
      inverse_(num_points),
      point_gradient_(num_points),
      point_steps_(num_points, Eigen::Vector3d::Zero()),
      motions_(num_ordered) {
  for (std::size_t i = 0; i < observations.size(); ++i) {
    const Dependence& observation = observations[i];
    point_of_.push_back(observation.point);
    const auto own = std::span(observation.blocks).first(observation.num_blocks);
    blocks_of_.insert(blocks_of_.end(), own.begin(), own.end());
    first_block_.push_back(blocks_of_.size());
    if (observation.point >= 0) of_point_[observation.point].push_back(static_cast<int>(i));
    int column = 0;
    for (const int block : own) {
      parts_of_block_[block].push_back({static_cast<int>(i), column});
      column += sizes_[block];
    }
    first_column_.push_back(first_column_.back() + column);
  }
  by_blocks_.assign(2 * first_column_.back(), 0.0);
  for (const int size : sizes_) {
    prior_weights_.emplace_back(Eigen::VectorXd::Zero(size));
    prior_residuals_.emplace_back(Eigen::VectorXd::Zero(size));
    held_.emplace_back(size, 0);
  }
  FindEntries();
  Order(most_work, observations);
  ListFills();
}

// One entry for each point and block that see each other, with room for its 3 columns of B^T P.
void ReducedSystem::FindEntries() {
  first_entry_.assign(1, 0);
  entries_of_block_.resize(sizes_.size());
  entry_of_.assign(blocks_of_.size(), -1);
  std::size_t at = 0;
  std::vector<int> last(sizes_.size(), -1);  // entry of each block
  for (int point = 0; point < num_points_; ++point) {
    const auto first = static_cast<int>(entries_.size());
    for (const int i : of_point_[point]) {
      for (std::size_t k = first_block_[i]; k < first_block_[i + 1]; ++k) {
        const int block = blocks_of_[k];
        if (last[block] < first) {
          last[block] = static_cast<int>(entries_.size());
          entries_of_block_[block].push_back(last[block]);
          entries_.push_back({point, block, at});
          at += 3 * static_cast<std::size_t>(sizes_[block]);
        }
        entry_of_[k] = last[block];
      }
    }
    first_entry_.push_back(entries_.size());
  }
  cross_.assign(at, 0.0);
}

void ReducedSystem::EliminatePoint(int point, double radius) {
  Eigen::Matrix3d own = Eigen::Matrix3d::Zero();
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  const std::size_t first = first_entry_[point], last = first_entry_[point + 1];
  if (first < last) {
    const std::size_t end = last < entries_.size() ? entries_[last].at : cross_.size();
    std::fill(&cross_[entries_[first].at], cross_.data() + end, 0.0);
  }
  for (const int i : of_point_[point]) {
    const Eigen::Matrix<double, 2, 3>& by_point = by_point_[i];
    own.noalias() += by_point.transpose() * by_point;
    gradient.noalias() += by_point.transpose() * residuals_[i];
    const Eigen::Matrix<double, 3, 2> transposed = by_point.transpose();
    const double* row = &by_blocks_[2 * first_column_[i]];
    for (std::size_t k = first_block_[i]; k < first_block_[i + 1]; ++k) {
      const int size = sizes_[blocks_of_[k]];
      const ProductTerm term = {&cross_[entries_[entry_of_[k]].at], transposed.data(), 3};
      SubtractProducts({&term, 1}, size, row, kMinus.data(), size, 2);
      row += 2 * size;
    }
  }
  // Levenberg-Marquardt with Marquardt's scaling: the diagonal grows by a share of itself.
  for (int k = 0; k < 3; ++k) own(k, k) += Damping(own(k, k), radius);
  inverse_[point] = own.inverse();
  point_gradient_[point] = gradient;
}

void ReducedSystem::FillRow(const Fill& fill, double radius) {
  const int block = fill.block, size = sizes_[block];
  const bool has_diagonal = Covers(fill, block);
  const std::ptrdiff_t stride = Stride(block);
  Eigen::VectorXd side = Eigen::VectorXd::Zero(size);
  // Where the blocks of the row are. Only those of lower rank: S is symmetric, and its lower half
  // is kept.
  std::vector<double*> tiles(sizes_.size(), nullptr);
  for (std::size_t other = 0; other < sizes_.size(); ++other) {
    if (Covers(fill, static_cast<int>(other)))
      tiles[other] = TileOf(block, static_cast<int>(other));
  }
  // B^T B and -B^T r of the observations that have this block.
  std::vector<ProductTerm> terms;
  const std::vector<Part>& parts = parts_of_block_[block];
  for (std::size_t n = 0; n < parts.size(); ++n) {
    const Part& part = parts[n];
    const int i = part.observation;
    if (n + kAhead < parts.size()) {
      hwy::Prefetch(&by_blocks_[2 * first_column_[parts[n + kAhead].observation]]);
    }
    const double* row = &by_blocks_[2 * first_column_[i]];
    const double* own = row + 2 * part.column;
    const Eigen::Vector2d opposite = -residuals_[i];
    terms.clear();
    if (has_diagonal) terms.push_back({side.data(), opposite.data(), 1});
    for (const int other : BlocksOf(i)) {
      if (tiles[other] != nullptr) terms.push_back({tiles[other], row, sizes_[other]});
      row += 2 * sizes_[other];
    }
    SubtractProducts(terms, stride, own, kMinus.data(), size, 2);
  }
  // Priors add to the diagonal alone. A held unknown gets a one: its row is zero otherwise, so that
  // its step is zero.
  if (has_diagonal) {
    auto diagonal = Eigen::Map<Eigen::MatrixXd, 0, Eigen::OuterStride<>>(
                        TileOf(block, block), size, size, Eigen::OuterStride<>(stride))
                        .diagonal();
    diagonal += prior_weights_[block].cwiseAbs2();
    side -= prior_weights_[block].cwiseProduct(prior_residuals_[block]);
    for (int k = 0; k < size; ++k) {
      diagonal[k] += held_[block][k] ? 1.0 : Damping(diagonal[k], radius);
    }
  }
  if (iterative_ && block < num_ordered_) {
    own_[block] = Eigen::Map<const Eigen::MatrixXd, 0, Eigen::OuterStride<>>(
        TileOf(block, block), size, size, Eigen::OuterStride<>(stride));
  }
  SubtractPoints(block, tiles, has_diagonal ? side.data() : nullptr);
  if (has_diagonal) step_.segment(start_[block], size) = side;
}

// - W P^T B and + W P^T r of the points that the block sees; tiles: null where the row has none.
void ReducedSystem::SubtractPoints(int block, std::span<double* const> tiles, double* side) {
  std::vector<ProductTerm> terms;
  const std::vector<int>& own_entries = entries_of_block_[block];
  for (std::size_t n = 0; n < own_entries.size(); ++n) {
    const Entry& entry = entries_[own_entries[n]];
    if (n + 2 * kAhead < own_entries.size()) {
      hwy::Prefetch(&entries_[own_entries[n + 2 * kAhead]]);
      const Entry& ahead = entries_[own_entries[n + kAhead]];
      hwy::Prefetch(&cross_[ahead.at]);
      hwy::Prefetch(&inverse_[ahead.point]);
      hwy::Prefetch(&point_gradient_[ahead.point]);
    }
    const Eigen::Vector3d opposite = -point_gradient_[entry.point];
    terms.clear();
    if (side != nullptr) terms.push_back({side, opposite.data(), 1});
    for (std::size_t e = first_entry_[entry.point]; e < first_entry_[entry.point + 1]; ++e) {
      const Entry& other = entries_[e];
      double* tile = tiles[other.block];
      if (tile != nullptr) terms.push_back({tile, &cross_[other.at], sizes_[other.block]});
    }
    SubtractProducts(terms, Stride(block), &cross_[entry.at], inverse_[entry.point].data(),
                     sizes_[block], 3);
  }
}

bool ReducedSystem::Solve(double radius) {
  ParallelFor(num_points_, kPointGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t point = begin; point < end; ++point) {
      EliminatePoint(static_cast<int>(point), radius);
    }
  });
  matrix_->SetZero();
  shared_.setZero();
  ParallelFor(static_cast<std::int64_t>(fills_.size()), 1,
              [&](std::int64_t begin, std::int64_t) { FillRow(fills_[begin], radius); });
  if (!step_.allFinite() || !matrix_->Factorize()) return false;
  if (iterative_) {
    if (!SolveIteratively()) return false;
  } else {
    matrix_->Solve(&step_);
  }
  // Back substitution: each point by itself.
  ParallelFor(num_points_, kPointGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t point = begin; point < end; ++point) {
      Eigen::Vector3d side = -point_gradient_[point];
      for (std::size_t e = first_entry_[point]; e < first_entry_[point + 1]; ++e) {
        const int block = entries_[e].block;
        side.noalias() -=
            Eigen::Map<const MatrixX3>(&cross_[entries_[e].at], sizes_[block], 3).transpose() *
            BlockStep(block);
      }
      point_steps_[point] = inverse_[point] * side;
    }
  });
  return step_.allFinite();
}

// The decrease of half the squares if residuals were linear: with c = J d the change of a residual
// r,
//   r^2 / 2 - (r + c)^2 / 2 = -c (r + c / 2).
// Summed over residuals as they are, undamped: the damping is no part of the cost.
double ReducedSystem::PredictedDecrease() const {
  const auto count = static_cast<std::int64_t>(residuals_.size());
  double decrease =
      ParallelSum(count, kObservationGrain, [&](std::int64_t begin, std::int64_t end) {
        double sum = 0.0;
        for (std::int64_t i = begin; i < end; ++i) {
          Eigen::Vector2d change = Eigen::Vector2d::Zero();
          if (point_of_[i] >= 0) change = by_point_[i] * point_steps_[point_of_[i]];
          const double* row = &by_blocks_[2 * first_column_[i]];
          for (const int block : BlocksOf(i)) {
            change.noalias() += Jacobian(row, 2, sizes_[block]) * BlockStep(block);
            row += 2 * sizes_[block];
          }
          sum -= change.dot(residuals_[i] + 0.5 * change);
        }
        return sum;
      });
  for (std::size_t block = 0; block < sizes_.size(); ++block) {
    const Eigen::VectorXd change =
        prior_weights_[block].cwiseProduct(BlockStep(static_cast<int>(block)));
    decrease -= change.dot(prior_residuals_[block] + 0.5 * change);
  }
  return decrease;
}

}  // namespace gsut
