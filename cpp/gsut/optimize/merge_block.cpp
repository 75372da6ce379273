// Greedy merging with near neighbours as candidates and a heap of each cluster's best partner.
#include "gsut/optimize/merge_block.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <queue>
#include <utility>

#include "gsut/gaussians/activations.h"
#include "gsut/optimize/cluster.h"

namespace gsut {
namespace {

using Place = std::uint32_t;  // of a cluster within its block
constexpr Place kNobody = std::numeric_limits<Place>::max();
constexpr double kNever = std::numeric_limits<double>::infinity();
// Candidates that a merged cluster keeps, in multiples of a single one's.
constexpr int kMergedCandidates = 2;

// Clusters of single Gaussians, about the block's middle, so that double has digits to spare.
std::vector<Cluster> ClustersOf(const GaussiansView<const float>& gaussians, BlockRows block,
                                const float* weights, double* origin) {
  std::fill_n(origin, 3, 0.0);
  for (std::int64_t i = 0; i < block.count; ++i) {
    for (int k = 0; k < 3; ++k) {
      origin[k] += gaussians.means[3 * std::size_t{block.rows[i]} + static_cast<std::size_t>(k)] /
                   static_cast<double>(block.count);
    }
  }
  std::vector<Cluster> clusters;
  clusters.reserve(static_cast<std::size_t>(block.count));
  for (std::int64_t i = 0; i < block.count; ++i) {
    const Place row = block.rows[i];
    const double weight = weights == nullptr ? -1.0 : std::max(0.0f, weights[row]);
    clusters.push_back(ClusterOf(gaussians, row, weight, origin));
  }
  return clusters;
}

// Merges the cheapest pair, again and again. A heap holds for each cluster its cheapest partner at
// the time of the entry. Merging a and b makes a new cluster in a's place, so that entries about
// either are out of date; they are recognised and mended when they come to the top:
//   a stamp per cluster:   only its latest entry counts;
//   a version per cluster: an entry counts only if its partner has not merged since;
//   heirs (union-find):    candidates that went into others are replaced by them.
// Costs of a cluster with its changed partner may have fallen, and are found only when one of the
// two is refreshed: greedy to that extent, in n log n instead of n^2 log n.
class Planner {
 public:
  Planner(std::vector<Cluster> clusters, const MergeOptions& options)
      : options_(options), clusters_(std::move(clusters)) {
    const std::size_t count = clusters_.size();
    alive_.assign(count, 1);
    version_.assign(count, 0);
    best_.assign(count, {kNever, kNobody, 0});
    heir_.resize(count);
    std::iota(heir_.begin(), heir_.end(), Place{0});
    candidates_.resize(count);
    FindNeighbors();
    for (Place place = 0; place < count; ++place) Refresh(place);
  }

  std::vector<MergeStep> Run(std::int64_t kept) {
    std::vector<MergeStep> steps;
    auto left = static_cast<std::int64_t>(clusters_.size());
    while (left > kept && !heap_.empty()) {
      const Entry top = heap_.top();
      heap_.pop();
      if (!alive_[top.place] || top.stamp != stamps_[top.place]) continue;
      const Best& best = best_[top.place];
      if (!alive_[best.partner] || version_[best.partner] != best.partner_version) {
        Refresh(top.place);
        continue;
      }
      steps.push_back(Join(top.place, best.partner, top.cost));
      --left;
    }
    return steps;
  }

 private:
  struct Best {
    double cost;
    Place partner;
    std::uint32_t partner_version;
  };
  struct Entry {
    double cost;
    Place place;
    std::uint32_t stamp;
    // The largest on top of a priority queue: the least cost, then the first place.
    bool operator<(const Entry& other) const {
      return cost != other.cost ? cost > other.cost : place > other.place;
    }
  };

  // The nearest centres of each cluster, by all distances: blocks are small.
  void FindNeighbors() {
    const std::size_t count = clusters_.size();
    const std::size_t wanted =
        std::min(static_cast<std::size_t>(options_.neighbors), count - (count > 0));
    stamps_.assign(count, 0);
    std::vector<float> x(count), y(count), z(count), distance(count);
    for (std::size_t i = 0; i < count; ++i) {
      x[i] = static_cast<float>(clusters_[i].moments.mean[0]);
      y[i] = static_cast<float>(clusters_[i].moments.mean[1]);
      z[i] = static_cast<float>(clusters_[i].moments.mean[2]);
    }
    // All distances, 1024^2 at most: a loop that the compiler vectorises beats any tree.
    std::vector<std::pair<float, Place>> nearest;
    for (std::size_t i = 0; i < count; ++i) {
      for (std::size_t j = 0; j < count; ++j) {
        const float dx = x[j] - x[i], dy = y[j] - y[i], dz = z[j] - z[i];
        distance[j] = dx * dx + dy * dy + dz * dz;
      }
      distance[i] = std::numeric_limits<float>::infinity();
      nearest.clear();  // kept sorted: most points are farther than the last of it
      for (std::size_t j = 0; j < count; ++j) {
        if (nearest.size() == wanted && (wanted == 0 || !(distance[j] < nearest.back().first))) {
          continue;
        }
        if (j == i) continue;
        const std::pair<float, Place> entry{distance[j], static_cast<Place>(j)};
        if (nearest.size() == wanted) nearest.pop_back();
        nearest.insert(std::upper_bound(nearest.begin(), nearest.end(), entry), entry);
      }
      for (const auto& [square, place] : nearest) candidates_[i].push_back(place);
    }
  }

  // With path halving, as in any union-find.
  Place Heir(Place place) {
    while (heir_[place] != place) {
      heir_[place] = heir_[heir_[place]];
      place = heir_[place];
    }
    return place;
  }

  // Brings a cluster's candidates up to date, finds the cheapest and puts it on the heap.
  void Refresh(Place place) {
    std::vector<Place>& candidates = candidates_[place];
    for (Place& candidate : candidates) candidate = Heir(candidate);
    std::sort(candidates.begin(), candidates.end());
    candidates.erase(std::unique(candidates.begin(), candidates.end()), candidates.end());
    std::erase(candidates, place);
    // All neighbours have gone into this cluster: look farther.
    if (candidates.empty()) AddNearestAlive(place);
    std::vector<std::pair<double, Place>> costs;
    costs.reserve(candidates.size());
    for (const Place candidate : candidates) {
      costs.emplace_back(CostOfMerging(clusters_[place], clusters_[candidate], options_),
                         candidate);
    }
    // Alone in its block: nothing to merge with.
    if (costs.empty()) return;
    // Candidates of both parents add up; only the cheapest stay.
    const auto most = static_cast<std::size_t>(kMergedCandidates * options_.neighbors);
    if (costs.size() > most) {
      std::sort(costs.begin(), costs.end());
      costs.resize(most);
      candidates.clear();
      for (const auto& [cost, candidate] : costs) candidates.push_back(candidate);
    }
    const auto [cost, partner] = *std::min_element(costs.begin(), costs.end());
    best_[place] = {cost, partner, version_[partner]};
    heap_.push({cost, place, ++stamps_[place]});
  }

  void AddNearestAlive(Place place) {
    double least = kNever;
    Place nearest = kNobody;
    for (Place other = 0; other < clusters_.size(); ++other) {
      if (other == place || !alive_[other]) continue;
      const double square =
          (clusters_[other].moments.mean - clusters_[place].moments.mean).squaredNorm();
      if (square < least) {
        least = square;
        nearest = other;
      }
    }
    if (nearest != kNobody) candidates_[place].push_back(nearest);
  }

  MergeStep Join(Place a, Place b, double cost) {
    const Place into = std::min(a, b), other = std::max(a, b);
    clusters_[into] = Merge(clusters_[into], clusters_[other]);
    clusters_[other] = Cluster();
    alive_[other] = 0;
    heir_[other] = into;
    ++version_[into];
    auto& candidates = candidates_[into];
    candidates.insert(candidates.end(), candidates_[other].begin(), candidates_[other].end());
    candidates_[other] = {};
    Refresh(into);
    return {into, other, cost};
  }

  const MergeOptions& options_;
  std::vector<Cluster> clusters_;
  std::vector<std::uint8_t> alive_;
  std::vector<std::uint32_t> version_;  // grows with each merge
  std::vector<std::uint32_t> stamps_;   // of the cluster's last entry on the heap
  std::vector<Best> best_;
  std::vector<Place> heir_;  // the cluster that a dead one went into
  std::vector<std::vector<Place>> candidates_;
  std::priority_queue<Entry> heap_;
};

// What was never merged keeps its bits.
void CopyRowTo(const GaussiansView<const float>& from, std::int64_t row,
               const GaussiansView<float>& to, std::int64_t place) {
  const std::int64_t sh = 3 * std::int64_t{from.sh_coefficients};
  std::copy_n(from.means + 3 * row, 3, to.means + 3 * place);
  std::copy_n(from.quats + 4 * row, 4, to.quats + 4 * place);
  std::copy_n(from.log_scales + 3 * row, 3, to.log_scales + 3 * place);
  to.opacity_logits[place] = from.opacity_logits[row];
  std::copy_n(from.sh + sh * row, sh, to.sh + sh * place);
}

}  // namespace

std::vector<MergeStep> PlanMerges(const GaussiansView<const float>& gaussians, BlockRows block,
                                  const float* weights, std::int64_t kept,
                                  const MergeOptions& options) {
  double origin[3];
  return Planner(ClustersOf(gaussians, block, weights, origin), options).Run(kept);
}

void CarryOutMerges(const GaussiansView<const float>& gaussians, BlockRows block,
                    const float* weights, const std::vector<MergeStep>& steps,
                    const GaussiansView<float>& out, std::int64_t first) {
  double origin[3];
  std::vector<Cluster> clusters = ClustersOf(gaussians, block, weights, origin);
  std::vector<std::uint8_t> alive(clusters.size(), 1);
  for (const MergeStep& step : steps) {
    clusters[step.into] = Merge(clusters[step.into], clusters[step.other]);
    alive[step.other] = 0;
  }
  std::int64_t place = first;
  for (std::size_t i = 0; i < clusters.size(); ++i) {
    if (!alive[i]) continue;
    const Cluster& cluster = clusters[i];
    if (!cluster.merged) {
      CopyRowTo(gaussians, block.rows[i], out, place++);
      continue;
    }
    for (int k = 0; k < 3; ++k) {
      out.means[3 * place + k] = static_cast<float>(cluster.moments.mean[k] + origin[k]);
    }
    ParametersOf(cluster.moments.covariance, 0.0, out.quats + 4 * place,
                 out.log_scales + 3 * place);
    out.opacity_logits[place] = static_cast<float>(Logit(cluster.opacity));
    for (std::size_t k = 0; k < cluster.sh.size(); ++k) {
      out.sh[cluster.sh.size() * static_cast<std::size_t>(place) + k] =
          static_cast<float>(cluster.sh[k]);
    }
    ++place;
  }
}

}  // namespace gsut
