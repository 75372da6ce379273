// Cholesky factorisation of a symmetric matrix in tiles, of which those that stay zero are left
// out.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace gsut {

// The lower half of a matrix, then its factor: a band stays a band, a dense matrix is a dense one.
// The same bits on any number of threads.
class TiledCholesky {
 public:
  // sizes: rows of each row of tiles, N of them. present: (N, N) row-major, which tiles of the
  // lower half are not zero; those that the factor adds are found here.
  TiledCholesky(std::vector<int> sizes, std::vector<std::uint8_t> present);

  // A tile that is present, column-major, sizes[row] rows.
  double* Tile(int row, int column) { return &values_[place_[row * num_tiles() + column]]; }
  int size() const { return starts_.back(); }
  int num_tiles() const { return static_cast<int>(sizes_.size()); }
  // Share of the lower half's tiles that the factor has.
  double Fill() const;
  // Multiplications that the factorisation takes, roughly.
  double Work() const;

  void SetZero();  // to begin with: there are no values before
  // Replaces the matrix by its factor; false: it is not positive definite.
  bool Factorize();
  // Solves for a right-hand side, in place.
  void Solve(Eigen::VectorXd* x) const;

 private:
  using Map = Eigen::Map<Eigen::MatrixXd>;
  using ConstMap = Eigen::Map<const Eigen::MatrixXd>;
  bool Has(int row, int column) const { return present_[row * num_tiles() + column] != 0; }
  Map At(int row, int column) { return {Tile(row, column), sizes_[row], sizes_[column]}; }
  ConstMap At(int row, int column) const {
    return {&values_[place_[row * num_tiles() + column]], sizes_[row], sizes_[column]};
  }
  // Takes off a tile what the columns before its own explain.
  void Reduce(int row, int column);

  std::vector<int> sizes_, starts_;
  std::vector<std::uint8_t> present_;
  std::vector<std::size_t> place_;
  std::size_t num_values_ = 0;
  std::vector<double> values_;
};

}  // namespace gsut
