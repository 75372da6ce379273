// The order of the blocks of the reduced system, and of the work that fills it.
#include <Eigen/OrderingMethods>
#include <Eigen/SparseCore>
#include <algorithm>
#include <numeric>

#include "gsut/sfm/reduced_system.h"

namespace gsut {
namespace {

// Rows of a tile, at least, of all but the last: ten poses, 29 KB, so that three fit in the cache.
constexpr int kTileRows = 60;
// Share of the pairs of blocks with a common point, beyond which no order is better than another.
constexpr double kDense = 0.5;
// The same of a cluster of conjugate gradients: 32 poses, or 16 that move.
constexpr int kClusterRows = 192;
// Parts of the row of a shared block, beside its diagonal. Each goes through all observations and
// points of the block, so that many parts cost more than they save.
constexpr int kSharedParts = 4;

// Blocks in this order, in tiles.
struct Tiling {
  std::vector<int> tile, in_tile, rows;  // by block; by tile
};

// Fills tiles with whole blocks in this order, each until it has kTileRows rows.
Tiling Tile(const std::vector<int>& order, const std::vector<int>& sizes) {
  Tiling tiling = {std::vector<int>(sizes.size()), std::vector<int>(sizes.size()), {}};
  for (const int block : order) {
    if (tiling.rows.empty() || tiling.rows.back() >= kTileRows) tiling.rows.push_back(0);
    tiling.tile[block] = static_cast<int>(tiling.rows.size()) - 1;
    tiling.in_tile[block] = tiling.rows.back();
    tiling.rows.back() += sizes[block];
  }
  return tiling;
}

using Pairs = std::vector<std::vector<int>>;  // by block those with a larger number joined to it

// A tile is present if any block in its rows is joined to one in its columns.
std::unique_ptr<TiledCholesky> MakeMatrix(const Tiling& tiling, const Pairs& joined) {
  const std::size_t tiles = tiling.rows.size();
  std::vector<std::uint8_t> present(tiles * tiles, 0);
  for (std::size_t a = 0; a < joined.size(); ++a) {
    for (const int b : joined[a]) {
      const auto [low, high] = std::minmax(tiling.tile[a], tiling.tile[b]);
      present[high * tiles + low] = 1;
    }
  }
  return std::make_unique<TiledCholesky>(tiling.rows, std::move(present));
}

// Blocks are joined, and S has a block there, if one point or observation depends on both.
Pairs FindJoined(std::size_t blocks, const std::vector<std::vector<int>>& together) {
  std::vector<std::uint8_t> flags(blocks * blocks, 0);
  for (const std::vector<int>& group : together) {
    for (const int a : group) {
      for (const int b : group) flags[a * blocks + b] = 1;
    }
  }
  Pairs joined(blocks);
  for (std::size_t a = 0; a < blocks; ++a) {
    for (std::size_t b = a + 1; b < blocks; ++b) {
      if (flags[a * blocks + b]) joined[a].push_back(static_cast<int>(b));
    }
  }
  return joined;
}

// Minimum degree (Amestoy, Davis, Duff, "An approximate minimum degree ordering algorithm", 1996)
// of the first blocks, then the others.
std::vector<int> MinimumDegree(int num_ordered, const Pairs& joined) {
  std::vector<Eigen::Triplet<double>> values;
  for (int a = 0; a < num_ordered; ++a) {
    values.emplace_back(a, a, 1.0);
    for (const int b : joined[a]) {
      if (b >= num_ordered) continue;
      values.emplace_back(a, b, 1.0);
      values.emplace_back(b, a, 1.0);
    }
  }
  Eigen::SparseMatrix<double> pattern(num_ordered, num_ordered);
  pattern.setFromTriplets(values.begin(), values.end());
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> found;
  Eigen::AMDOrdering<int>()(pattern, found);
  std::vector<int> order(joined.size());
  std::iota(order.begin(), order.end(), 0);
  for (int i = 0; i < num_ordered; ++i) order[i] = found.indices()[i];
  return order;
}

// Clusters of blocks that have many points in common, as tiles: each begins with the first block
// that is left, and the next is the one that has most points in common with those it has.
Tiling Cluster(int num_ordered, const std::vector<int>& sizes,
               const std::vector<std::vector<int>>& together, std::vector<int>* order) {
  const auto count = static_cast<std::size_t>(num_ordered);
  std::vector<int> common(count * count, 0);
  for (const std::vector<int>& group : together) {
    for (const int a : group) {
      for (const int b : group) {
        if (a < num_ordered && b < num_ordered) ++common[a * count + b];
      }
    }
  }
  Tiling tiling = {std::vector<int>(sizes.size()), std::vector<int>(sizes.size()), {}};
  std::vector<std::uint8_t> taken(count, 0);
  order->clear();
  for (int first = 0; first < num_ordered; ++first) {
    std::vector<int> tie(count, 0);
    for (int next = taken[first] ? -1 : first; next >= 0;) {
      if (next == first) tiling.rows.push_back(0);
      taken[next] = 1;
      order->push_back(next);
      tiling.tile[next] = static_cast<int>(tiling.rows.size()) - 1;
      tiling.in_tile[next] = tiling.rows.back();
      tiling.rows.back() += sizes[next];
      if (tiling.rows.back() >= kClusterRows) break;
      const int* row = &common[next * count];
      next = -1;
      for (int other = 0; other < num_ordered; ++other) {
        tie[other] += row[other];
        if (!taken[other] && tie[other] > (next < 0 ? 0 : tie[next])) next = other;
      }
    }
  }
  return tiling;
}

}  // namespace

// Chooses the order of blocks, as given (time, for a walk) or by minimum degree, by which its
// factor costs less. Dense systems skip the attempt: every order fills them.
void ReducedSystem::Order(double most_work, const std::vector<Dependence>& observations) {
  std::vector<std::vector<int>> together(num_points_);
  for (int point = 0; point < num_points_; ++point) {
    for (std::size_t e = first_entry_[point]; e < first_entry_[point + 1]; ++e) {
      together[point].push_back(entries_[e].block);
    }
  }
  for (const Dependence& observation : observations) {
    if (observation.point >= 0 || observation.num_blocks < 2) continue;
    const auto own = std::span(observation.blocks).first(observation.num_blocks);
    together.emplace_back(own.begin(), own.end());
  }
  const Pairs joined = FindJoined(sizes_.size(), together);
  std::vector<int> order(sizes_.size());
  std::iota(order.begin(), order.end(), 0);
  Tiling tiling = Tile(order, sizes_);
  matrix_ = MakeMatrix(tiling, joined);
  int num_ordered = num_ordered_;
  if (matrix_->Fill() > kDense && num_ordered > 1) {
    std::size_t pairs = 0;
    for (const auto& others : joined) pairs += others.size();
    const double all = 0.5 * static_cast<double>(sizes_.size() * (sizes_.size() - 1));
    if (static_cast<double>(pairs) > kDense * all) num_ordered = 0;
  }
  if (num_ordered > 1) {
    std::vector<int> other_order = MinimumDegree(num_ordered, joined);
    Tiling other_tiling = Tile(other_order, sizes_);
    auto other = MakeMatrix(other_tiling, joined);
    if (other->Work() < matrix_->Work()) {
      order = std::move(other_order);
      tiling = std::move(other_tiling);
      matrix_ = std::move(other);
    }
  }
  iterative_ = num_ordered_ > 1 && matrix_->Work() > most_work;
  if (iterative_) {
    tiling = Cluster(num_ordered_, sizes_, together, &order);
    const std::size_t tiles = tiling.rows.size();
    matrix_ =
        std::make_unique<TiledCholesky>(tiling.rows, std::vector<std::uint8_t>(tiles * tiles));
    tiling.rows.push_back(0);  // of all shared blocks
    for (int block = num_ordered_; block < static_cast<int>(sizes_.size()); ++block) {
      order.push_back(block);
      tiling.tile[block] = static_cast<int>(tiles);
      tiling.in_tile[block] = tiling.rows.back();
      tiling.rows.back() += sizes_[block];
    }
  }
  rank_.resize(sizes_.size());
  start_.resize(sizes_.size());
  int start = 0;
  for (std::size_t place = 0; place < order.size(); ++place) {
    rank_[order[place]] = static_cast<int>(place);
    start_[order[place]] = start;
    start += sizes_[order[place]];
  }
  step_.resize(start);
  if (iterative_) {
    own_.resize(num_ordered_);
    shared_.resize(tiling.rows.back(), start);
  }
  tile_ = std::move(tiling.tile);
  in_tile_ = std::move(tiling.in_tile);
  rows_of_tile_ = std::move(tiling.rows);
}

// The longest first, or the last one to begin would end long after the others: rows grow with the
// rank.
void ReducedSystem::ListFills() {
  std::vector<int> order(sizes_.size());
  for (std::size_t block = 0; block < sizes_.size(); ++block) {
    order[rank_[block]] = static_cast<int>(block);
  }
  for (int rank = static_cast<int>(sizes_.size()) - 1; rank >= 0; --rank) {
    const int block = order[rank];
    if (block < num_ordered_) {
      int first = iterative_ ? rank : 0;
      while (first > 0 && tile_[order[first - 1]] == tile_[block]) --first;
      fills_.push_back({block, first, rank + 1});
      continue;
    }
    fills_.push_back({block, rank, rank + 1});
    for (int part = 0; part < kSharedParts; ++part) {
      fills_.push_back({block, rank * part / kSharedParts, rank * (part + 1) / kSharedParts});
    }
  }
}

}  // namespace gsut
