// GHAP as published: k-means on means and covariances in the blocks of a k-d tree.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/base/rng.h"
#include "gsut/gaussians/activations.h"
#include "gsut/optimize/blocks.h"
#include "gsut/optimize/compact.h"
#include "gsut/optimize/moments.h"
#include "gsut/optimize/training_state.h"

namespace gsut {
namespace {

// GHAP (Wang et al., "Gaussian Herding across Pens", 2025): reduce a mixture block by block
// ("pens" of a k-d tree) by k-means on Gaussians themselves, in which a cluster's centre averages
// means and covariances, weighted by opacity.

// Mean (3) and covariance (xx, yy, zz, then xy, xz, yz times sqrt 2): the squared distance of two
// is |dmean|^2 + |dcov|_F^2.
constexpr int kFeatures = 9;
using Feature = std::array<double, kFeatures>;

struct Member {
  Feature feature;
  double weight;  // opacity; dividing by the block's sum changes no average
};

Feature FeatureOf(const Eigen::Vector3d& mean, const Eigen::Matrix3d& c) {
  constexpr double kRoot2 = std::numbers::sqrt2;
  return {mean[0], mean[1],          mean[2],          c(0, 0),         c(1, 1),
          c(2, 2), kRoot2 * c(0, 1), kRoot2 * c(0, 2), kRoot2 * c(1, 2)};
}

Eigen::Matrix3d CovarianceOfFeature(const Feature& f) {
  constexpr double kRoot2 = std::numbers::sqrt2;
  Eigen::Matrix3d c;
  c << f[3], f[6] / kRoot2, f[7] / kRoot2, f[6] / kRoot2, f[4], f[8] / kRoot2, f[7] / kRoot2,
      f[8] / kRoot2, f[5];
  return c;
}

// k-means of one block.
class Herd {
 public:
  Herd(std::vector<Member> members, std::int64_t kept, const Rng& rng, const HerdOptions& options)
      : members_(std::move(members)) {
    Start(kept, rng);
    for (int round = 0; round < options.max_rounds; ++round) {
      Assign();
      if (Average() < options.tolerance) break;
    }
    Assign();
  }

  std::size_t centers() const { return centers_.size(); }
  const Feature& center(std::size_t c) const { return centers_[c]; }
  // The member nearest to each centre; -1 for a centre without members.
  std::vector<std::int64_t> Nearest() const {
    std::vector<std::int64_t> nearest(centers_.size(), -1);
    for (std::size_t i = 0; i < members_.size(); ++i) {
      std::int64_t& best = nearest[owner_[i]];
      if (best < 0 || distance_[i] < distance_[static_cast<std::size_t>(best)]) {
        best = static_cast<std::int64_t>(i);
      }
    }
    return nearest;
  }

 private:
  // `kept` different members at random: those with the smallest random keys.
  void Start(std::int64_t kept, const Rng& rng) {
    std::vector<std::pair<double, std::size_t>> keys;
    keys.reserve(members_.size());
    for (std::size_t i = 0; i < members_.size(); ++i) keys.emplace_back(rng.Uniform(i), i);
    std::sort(keys.begin(), keys.end());
    for (std::int64_t c = 0; c < kept; ++c) {
      centers_.push_back(members_[keys[static_cast<std::size_t>(c)].second].feature);
    }
    owner_.resize(members_.size());
    distance_.resize(members_.size());
  }

  // Squared distances to all centres, column by column, so that the inner loop is one vector's
  // work.
  void Assign() {
    const std::size_t count = centers_.size();
    std::vector<double> columns(kFeatures * count), square(count);
    for (std::size_t c = 0; c < count; ++c) {
      for (std::size_t k = 0; k < kFeatures; ++k) columns[k * count + c] = centers_[c][k];
    }
    for (std::size_t i = 0; i < members_.size(); ++i) {
      std::fill(square.begin(), square.end(), 0.0);
      for (std::size_t k = 0; k < kFeatures; ++k) {
        const double value = members_[i].feature[k];
        const double* column = &columns[k * count];
        for (std::size_t c = 0; c < count; ++c) {
          const double difference = column[c] - value;
          square[c] += difference * difference;
        }
      }
      const auto least = std::min_element(square.begin(), square.end());
      owner_[i] = static_cast<std::size_t>(least - square.begin());
      distance_[i] = *least;
    }
  }

  // Weighted averages; returns the largest change. A centre without members stays where it is.
  // The largest change of any entry ends the rounds, as in the paper.
  double Average() {
    std::vector<Feature> sums(centers_.size(), Feature{});
    std::vector<double> weights(centers_.size(), 0.0);
    for (std::size_t i = 0; i < members_.size(); ++i) {
      weights[owner_[i]] += members_[i].weight;
      for (std::size_t k = 0; k < kFeatures; ++k) {
        sums[owner_[i]][k] += members_[i].weight * members_[i].feature[k];
      }
    }
    double change = 0.0;
    for (std::size_t c = 0; c < centers_.size(); ++c) {
      if (!(weights[c] > 0.0)) continue;
      for (std::size_t k = 0; k < kFeatures; ++k) {
        const double value = sums[c][k] / weights[c];
        change = std::max(change, std::abs(value - centers_[c][k]));
        centers_[c][k] = value;
      }
    }
    return change;
  }

  std::vector<Member> members_;
  std::vector<Feature> centers_;
  std::vector<std::size_t> owner_;
  std::vector<double> distance_;
};

// The reduced Gaussians of one block.
GaussianArrays ReduceBlock(const GaussiansView<const float>& gaussians, const std::uint32_t* rows,
                           std::int64_t count, std::int64_t block, const HerdOptions& options) {
  std::vector<Member> members;
  members.reserve(static_cast<std::size_t>(count));
  for (std::int64_t i = 0; i < count; ++i) {
    const std::int64_t row = rows[i];
    const Eigen::Vector3d mean(gaussians.means[3 * row], gaussians.means[3 * row + 1],
                               gaussians.means[3 * row + 2]);
    members.push_back({FeatureOf(mean, CovarianceOf(gaussians, row)),
                       Sigmoid(static_cast<double>(gaussians.opacity_logits[row]))});
  }
  const std::int64_t kept =
      std::max<std::int64_t>(1, std::llround(options.keep * static_cast<double>(count)));
  const Rng rng(options.seed, RandomStream(RandomUse::kHerdStart, block));
  const Herd herd(std::move(members), kept, rng, options);
  const std::vector<std::int64_t> nearest = herd.Nearest();
  const auto size = std::count_if(nearest.begin(), nearest.end(), [](auto i) { return i >= 0; });
  GaussianArrays out(size, gaussians.sh_coefficients);
  const GaussiansView<float> view = out.View();
  const std::int64_t sh = 3 * std::int64_t{gaussians.sh_coefficients};
  std::int64_t place = 0;
  for (std::size_t c = 0; c < herd.centers(); ++c) {
    if (nearest[c] < 0) continue;
    const Feature& center = herd.center(c);
    // Centres take place and shape from their mean, opacity and colour from the nearest member: an
    // average of colours would blur what k-means has put together by place.
    const std::int64_t source = rows[nearest[c]];
    for (int k = 0; k < 3; ++k) {
      view.means[3 * place + k] = static_cast<float>(center[static_cast<std::size_t>(k)]);
    }
    ParametersOf(CovarianceOfFeature(center), options.least_variance, view.quats + 4 * place,
                 view.log_scales + 3 * place);
    view.opacity_logits[place] = gaussians.opacity_logits[source];
    std::copy_n(gaussians.sh + sh * source, sh, view.sh + sh * place);
    ++place;
  }
  return out;
}

}  // namespace

GaussianArrays HerdPaper(const GaussiansView<const float>& gaussians,
                         const std::vector<std::uint32_t>& rows, const HerdOptions& options) {
  if (!(options.keep > 0.0 && options.keep <= 1.0) || options.depth < 0 || options.max_rounds < 1) {
    throw InputError("keep must be above 0 and at most 1, depth >= 0 and max_rounds >= 1, found " +
                     std::to_string(options.keep) + ", " + std::to_string(options.depth) + " and " +
                     std::to_string(options.max_rounds));
  }
  CheckRows(gaussians, rows);
  const auto count = static_cast<std::int64_t>(rows.size());
  if (count == 0) return GaussianArrays(0, gaussians.sh_coefficients);
  // Blocks are independent: their random numbers depend on the block's number, not on the thread.
  int depth = options.depth;  // blocks that keep at least one each
  while (depth > 0 && options.keep * static_cast<double>(count >> depth) < 1.0) --depth;
  const Blocks blocks = SplitIntoBlocks(gaussians.means, rows, depth, BlockAxis::kCycle);
  std::vector<GaussianArrays> parts(static_cast<std::size_t>(blocks.size()),
                                    GaussianArrays(0, gaussians.sh_coefficients));
  ParallelFor(blocks.size(), 1, [&](std::int64_t b, std::int64_t) {
    const std::int64_t begin = blocks.begin[static_cast<std::size_t>(b)];
    const std::int64_t end = blocks.begin[static_cast<std::size_t>(b) + 1];
    parts[static_cast<std::size_t>(b)] =
        ReduceBlock(gaussians, blocks.order.data() + begin, end - begin, b, options);
  });
  GaussianArrays out(0, gaussians.sh_coefficients);
  const auto append = [](std::vector<float>* to, const std::vector<float>& from) {
    to->insert(to->end(), from.begin(), from.end());
  };
  for (const GaussianArrays& part : parts) {
    out.size += part.size;
    append(&out.means, part.means);
    append(&out.quats, part.quats);
    append(&out.log_scales, part.log_scales);
    append(&out.opacity_logits, part.opacity_logits);
    append(&out.sh, part.sh);
  }
  return out;
}

}  // namespace gsut
