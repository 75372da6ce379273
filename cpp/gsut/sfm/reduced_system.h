// The normal equations of observations of points, the points eliminated: one step of a solver.
#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <span>
#include <vector>

#include "gsut/sfm/tiled_cholesky.h"

namespace gsut {

// Unknowns are blocks (of poses and lenses, from 0) and points of three coordinates. An observation
// has two residuals, which depend on some blocks and on one point at most. Everything is summed in
// one order, each sum by one thread: the same bits on any number of threads.
class ReducedSystem {
 public:
  // Of an observation: its point (-1: it has none, or one that stays) and its blocks, each once.
  struct Dependence {
    int point = -1;
    int num_blocks = 0;
    std::array<int, 3> blocks = {};  // of a body, a mount and a lens at most
  };

  // block_sizes: those from num_ordered on come last, in their order, and are shared: many
  // observations have them. most_work: multiplications beyond which it is not factorised but solved
  // by conjugate gradients.
  ReducedSystem(std::vector<int> block_sizes, int num_ordered, int num_points,
                const std::vector<Dependence>& observations, double most_work = kMostWork);

  // Whether it is solved by conjugate gradients.
  bool iterative() const { return iterative_; }
  // For these, of a block that is not shared: its changes that change no residual if all blocks
  // change alike, one a column, as many of each block; none to begin with.
  Eigen::MatrixXd& Motions(int block) { return motions_[block]; }

  // Derivatives of an observation, weighted: row-major (2, size) one block after the other.
  double* ByBlocks(int observation) { return &by_blocks_[2 * first_column_[observation]]; }
  Eigen::Matrix<double, 2, 3>& ByPoint(int observation) { return by_point_[observation]; }
  Eigen::Vector2d& Residual(int observation) { return residuals_[observation]; }
  // Residuals of a block by itself: their weights (0: none), and they, weighted.
  Eigen::VectorXd& PriorWeights(int block) { return prior_weights_[block]; }
  Eigen::VectorXd& PriorResiduals(int block) { return prior_residuals_[block]; }
  // Components of a block that stay: 1. Their derivatives must be 0.
  std::vector<std::uint8_t>& Held(int block) { return held_[block]; }

  // The step of Levenberg-Marquardt: to the minimum, held back by the diagonal over the radius.
  // False: not determined.
  bool Solve(double radius);
  auto BlockStep(int block) const { return step_.segment(start_[block], sizes_[block]); }
  const Eigen::Vector3d& PointStep(int point) const { return point_steps_[point]; }
  // What the step lowers half the sum of squares by, were the residuals linear.
  double PredictedDecrease() const;
  const TiledCholesky& matrix() const { return *matrix_; }

 private:
  // Of a dense system of 650 poses, or of 330 with a velocity each.
  static constexpr double kMostWork = 1e10;
  struct Entry {  // a block that observes a point
    int point, block;
    std::size_t at;  // of its (size, 3) products in cross_
  };
  struct Part {  // an observation that has a block
    int observation;
    int column;  // of the block in ByBlocks
  };
  struct Fill {  // part of a row of S: the columns of the blocks of ranks [first, last)
    int block, first, last;
  };
  void Order(double most_work, const std::vector<Dependence>& observations);
  void FindEntries();
  void EliminatePoint(int point, double radius);
  void ListFills();
  void FillRow(const Fill& fill, double radius);
  void SubtractPoints(int block, std::span<double* const> tiles, double* side);
  // Whether the part of a row holds the columns of a block.
  bool Covers(const Fill& fill, int block) const {
    return rank_[block] >= fill.first && rank_[block] < fill.last;
  }
  std::ptrdiff_t Stride(int block) const { return rows_of_tile_[tile_[block]]; }
  // Blocks of an observation.
  std::span<const int> BlocksOf(std::size_t observation) const {
    const std::size_t first = first_block_[observation];
    return {blocks_of_.data() + first, first_block_[observation + 1] - first};
  }
  double* TileOf(int row, int column) {
    if (iterative_ && row >= num_ordered_) return &shared_(in_tile_[row], start_[column]);
    return matrix_->Tile(tile_[row], tile_[column]) + in_tile_[row] +
           static_cast<std::ptrdiff_t>(in_tile_[column]) * rows_of_tile_[tile_[row]];
  }

  // See reduced_iterative.cpp.
  bool SolveIteratively();
  void Multiply(const Eigen::VectorXd& x, Eigen::VectorXd* y);
  void ListClusters();
  bool FactorizeClusters();
  Eigen::VectorXd Precondition(const Eigen::VectorXd& residual) const;

  std::vector<int> sizes_;
  int num_ordered_, num_points_;
  std::vector<Fill> fills_;
  // By block: place in the order, first unknown, tile and row in it.
  std::vector<int> rank_, start_, tile_, in_tile_, rows_of_tile_;
  std::vector<int> point_of_;                            // by observation
  std::vector<std::size_t> first_block_, first_column_;  // by observation
  std::vector<int> blocks_of_, entry_of_;   // by observation and block: the entry, or -1
  std::vector<std::vector<int>> of_point_;  // observations
  std::vector<std::vector<Part>> parts_of_block_;
  std::vector<Entry> entries_;
  std::vector<std::size_t> first_entry_;  // by point
  std::vector<std::vector<int>> entries_of_block_;
  std::unique_ptr<TiledCholesky> matrix_;

  std::vector<double> by_blocks_;
  std::vector<Eigen::Matrix<double, 2, 3>> by_point_;
  std::vector<Eigen::Vector2d> residuals_;
  std::vector<Eigen::VectorXd> prior_weights_, prior_residuals_;
  std::vector<std::vector<std::uint8_t>> held_;

  std::vector<double> cross_;             // block by point
  std::vector<Eigen::Matrix3d> inverse_;  // of the point's own
  std::vector<Eigen::Vector3d> point_gradient_, point_steps_;
  Eigen::VectorXd step_;

  // Of conjugate gradients: by block its own B^T B + D, the rows of S of shared blocks, motions,
  // and of clusters (tiles of matrix_) their part of the motions, orthonormal.
  struct ClusterEntry {  // a cluster that observes a point
    int point, cluster;
    std::size_t at;  // of its (columns, 3) products in cluster_cross_
  };
  bool iterative_ = false;
  std::vector<Eigen::MatrixXd> own_, motions_, basis_;
  Eigen::MatrixXd shared_;
  std::vector<int> cluster_start_;  // by cluster its first column of the coarse system
  std::vector<ClusterEntry> cluster_entries_;
  std::vector<std::size_t> first_cluster_entry_;  // by point
  std::vector<std::vector<int>> entries_of_cluster_;
  std::vector<double> cluster_cross_;
  Eigen::MatrixXd coarse_;  // the coarse system's factor
};

}  // namespace gsut
