// Left-looking: tile by tile, each from those of the columns before.
#include "gsut/sfm/tiled_cholesky.h"

#include <algorithm>

#include "gsut/base/parallel.h"
#include "gsut/sfm/dense.h"
#include "gsut/sfm/subtract_product.h"

namespace gsut {
namespace {

constexpr std::int64_t kZeroGrain = 65536;  // numbers of a chunk: half a megabyte

}  // namespace

TiledCholesky::TiledCholesky(std::vector<int> sizes, std::vector<std::uint8_t> present)
    : sizes_(std::move(sizes)), starts_(1, 0), present_(std::move(present)) {
  const int count = num_tiles();
  for (const int size : sizes_) starts_.push_back(starts_.back() + size);
  // Fill: eliminating column k joins all pairs of tiles below its diagonal. Columns are taken in
  // order, so each sees the fill that those before it made.
  std::vector<int> rows;
  for (int k = 0; k < count; ++k) {
    present_[k * count + k] = 1;
    rows.clear();
    for (int i = k + 1; i < count; ++i) {
      if (Has(i, k)) rows.push_back(i);
    }
    for (const int i : rows) {
      for (const int j : rows) {
        if (j <= i) present_[i * count + j] = 1;
      }
    }
  }
  // Tiles are stored column by column, as the factorisation reads them.
  place_.assign(present_.size(), 0);
  for (int j = 0; j < count; ++j) {
    for (int i = j; i < count; ++i) {
      if (!Has(i, j)) continue;
      place_[i * count + j] = num_values_;
      num_values_ += static_cast<std::size_t>(sizes_[i]) * sizes_[j];
    }
  }
}

// 1 where nothing is zero: ordering has then gained nothing.
double TiledCholesky::Fill() const {
  const double count = num_tiles();
  double kept = 0.0;
  for (int i = 0; i < num_tiles(); ++i) {
    for (int j = 0; j <= i; ++j) kept += Has(i, j);
  }
  return kept / std::max(1.0, count * (count + 1) / 2);
}

// Eliminating a column of tiles with n rows below and s columns: n^2 s / 2 multiplications, as the
// outer product is symmetric.
double TiledCholesky::Work() const {
  double work = 0.0;
  for (int k = 0; k < num_tiles(); ++k) {
    double rows = 0.0;
    for (int i = k; i < num_tiles(); ++i) rows += Has(i, k) ? sizes_[i] : 0;
    work += 0.5 * rows * rows * sizes_[k];
  }
  return work;
}

void TiledCholesky::SetZero() {
  values_.resize(num_values_);
  ParallelFor(static_cast<std::int64_t>(values_.size()), kZeroGrain,
              [&](std::int64_t begin, std::int64_t end) {
                std::fill(values_.begin() + begin, values_.begin() + end, 0.0);
              });
}

// L_rc = (A_rc - sum over k < c of L_rk L_ck^T) L_cc^-T: this is the sum. Left-looking, so a tile
// is written once, from tiles that are final, and its sum has one order whatever thread computes
// it.
void TiledCholesky::Reduce(int row, int column) {
  const int rows = sizes_[row], columns = sizes_[column];
  for (int k = 0; k < column; ++k) {
    if (!Has(row, k) || !Has(column, k)) continue;
    SubtractProduct(Tile(row, column), rows, Tile(row, k), rows, Tile(column, k), columns, rows,
                    columns, sizes_[k]);
  }
}

bool TiledCholesky::Factorize() {
  std::vector<int> rows;
  for (int j = 0; j < num_tiles(); ++j) {
    Reduce(j, j);
    // The diagonal tile first, alone; then all tiles below it, in parallel.
    Map diagonal = At(j, j);
    if (!FactorizeCholesky(diagonal)) return false;
    rows.clear();
    for (int i = j + 1; i < num_tiles(); ++i) {
      if (Has(i, j)) rows.push_back(i);
    }
    ParallelFor(static_cast<std::int64_t>(rows.size()), 1, [&](std::int64_t begin, std::int64_t) {
      const int i = rows[begin];
      Reduce(i, j);
      Map tile = At(i, j);
      diagonal.triangularView<Eigen::Lower>().transpose().solveInPlace<Eigen::OnTheRight>(tile);
    });
  }
  return true;
}

// L y = x downwards, then L^T x = y upwards.
void TiledCholesky::Solve(Eigen::VectorXd* x) const {
  const auto part = [&](int i) { return x->segment(starts_[i], sizes_[i]); };
  for (int j = 0; j < num_tiles(); ++j) {
    for (int k = 0; k < j; ++k) {
      if (Has(j, k)) part(j).noalias() -= At(j, k) * part(k);
    }
    auto own = part(j);
    At(j, j).triangularView<Eigen::Lower>().solveInPlace(own);
  }
  for (int j = num_tiles() - 1; j >= 0; --j) {
    for (int i = j + 1; i < num_tiles(); ++i) {
      if (Has(i, j)) part(j).noalias() -= At(i, j).transpose() * part(i);
    }
    auto own = part(j);
    At(j, j).transpose().triangularView<Eigen::Upper>().solveInPlace(own);
  }
}

}  // namespace gsut
