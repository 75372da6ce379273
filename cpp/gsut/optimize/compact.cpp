// Merging across blocks: one threshold of cost for all of them.
#include "gsut/optimize/compact.h"

#include <algorithm>
#include <cmath>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/check_gaussians.h"
#include "gsut/optimize/blocks.h"
#include "gsut/optimize/merge_block.h"

namespace gsut {
namespace {

// What one block may shrink to when the share of all is `keep`: blocks of simple surfaces shrink
// more than the average, down to this fraction of it.
constexpr double kLeastOfShare = 0.1;

// Halvings until blocks have at most `block_rows` rows.
int DepthFor(std::int64_t rows, int block_rows) {
  int depth = 0;
  while ((rows >> depth) > block_rows) ++depth;
  return depth;
}

// How many merges each block makes: the `wanted` cheapest of all, a block's merges in their order.
std::vector<std::int64_t> ShareMerges(const std::vector<std::vector<MergeStep>>& steps,
                                      std::int64_t wanted) {
  // A merge can be made only after those before it in its block: it costs what the most expensive
  // of them cost.
  std::vector<double> costs;
  for (const auto& block : steps) {
    double highest = 0.0;
    for (const MergeStep& step : block) costs.push_back(highest = std::max(highest, step.cost));
  }
  std::vector<std::int64_t> made(steps.size(), 0);
  if (wanted <= 0 || costs.empty()) return made;
  wanted = std::min(wanted, static_cast<std::int64_t>(costs.size()));
  std::nth_element(costs.begin(), costs.begin() + (wanted - 1), costs.end());
  // The cost that the last of the wanted merges has, over all blocks: below it, a block makes all.
  const double threshold = costs[static_cast<std::size_t>(wanted - 1)];
  std::int64_t total = 0;
  for (std::size_t b = 0; b < steps.size(); ++b) {
    while (made[b] < static_cast<std::int64_t>(steps[b].size()) &&
           steps[b][static_cast<std::size_t>(made[b])].cost < threshold) {
      ++made[b];
    }
    total += made[b];
  }
  // Merges that cost exactly the threshold: block by block until there are enough.
  for (std::size_t b = 0; b < steps.size() && total < wanted; ++b) {
    while (total < wanted && made[b] < static_cast<std::int64_t>(steps[b].size()) &&
           steps[b][static_cast<std::size_t>(made[b])].cost <= threshold) {
      ++made[b];
      ++total;
    }
  }
  return made;
}

}  // namespace

GaussianArrays::GaussianArrays(std::int64_t size_in, int sh_coefficients_in)
    : size(size_in),
      sh_coefficients(sh_coefficients_in),
      means(3 * static_cast<std::size_t>(size)),
      quats(4 * static_cast<std::size_t>(size)),
      log_scales(3 * static_cast<std::size_t>(size)),
      opacity_logits(static_cast<std::size_t>(size)),
      sh(3 * static_cast<std::size_t>(sh_coefficients) * static_cast<std::size_t>(size)) {}

GaussiansView<float> GaussianArrays::View() {
  return {size,         sh_coefficients,   means.data(),
          quats.data(), log_scales.data(), opacity_logits.data(),
          sh.data()};
}

void CheckRows(const GaussiansView<const float>& gaussians,
               const std::vector<std::uint32_t>& rows) {
  CheckGaussians(gaussians);
  if (!rows.empty() && *std::max_element(rows.begin(), rows.end()) >= gaussians.size) {
    throw InputError("rows name a Gaussian that is not among the " +
                     std::to_string(gaussians.size));
  }
}

GaussianArrays MergePairs(const GaussiansView<const float>& gaussians,
                          const std::vector<std::uint32_t>& rows, const float* weights,
                          std::int64_t target, const MergeOptions& options) {
  if (target < 1) {
    throw InputError("target is " + std::to_string(target) + "; at least one Gaussian must stay");
  }
  if (!(options.field_weight >= 0.0)) {
    throw InputError("field_weight must be >= 0, found " + std::to_string(options.field_weight));
  }
  if (options.neighbors < 1 || options.block_rows < 2) {
    throw InputError("neighbors must be >= 1 and block_rows >= 2, found " +
                     std::to_string(options.neighbors) + " and " +
                     std::to_string(options.block_rows));
  }
  CheckRows(gaussians, rows);
  const auto count = static_cast<std::int64_t>(rows.size());
  if (count == 0) return GaussianArrays(0, gaussians.sh_coefficients);
  const Blocks blocks = SplitIntoBlocks(gaussians.means, rows, DepthFor(count, options.block_rows),
                                        BlockAxis::kPrincipal);
  const double keep = static_cast<double>(target) / static_cast<double>(count);
  const auto rows_of = [&](std::int64_t b) {
    const std::int64_t begin = blocks.begin[static_cast<std::size_t>(b)];
    return BlockRows{blocks.order.data() + begin,
                     blocks.begin[static_cast<std::size_t>(b) + 1] - begin};
  };
  // 1. Each block plans merges beyond its share, by itself. 2. One threshold over all blocks
  // decides how many each makes. 3. Each makes them again from the start, which costs less than
  // keeping every state of every plan.
  std::vector<std::vector<MergeStep>> steps(static_cast<std::size_t>(blocks.size()));
  if (target < count) {
    ParallelFor(blocks.size(), 1, [&](std::int64_t b, std::int64_t) {
      const BlockRows block = rows_of(b);
      const double least =
          blocks.size() == 1 ? static_cast<double>(target) : kLeastOfShare * keep * block.count;
      const auto kept = std::max<std::int64_t>(1, std::llround(std::floor(least)));
      steps[static_cast<std::size_t>(b)] = PlanMerges(gaussians, block, weights, kept, options);
    });
  }
  const std::vector<std::int64_t> made = ShareMerges(steps, count - target);
  std::vector<std::int64_t> first(static_cast<std::size_t>(blocks.size()) + 1, 0);
  for (std::size_t b = 0; b + 1 < first.size(); ++b) {
    first[b + 1] = first[b] + rows_of(static_cast<std::int64_t>(b)).count - made[b];
  }
  GaussianArrays out(first.back(), gaussians.sh_coefficients);
  const GaussiansView<float> view = out.View();
  ParallelFor(blocks.size(), 1, [&](std::int64_t b, std::int64_t) {
    auto& plan = steps[static_cast<std::size_t>(b)];
    plan.resize(static_cast<std::size_t>(made[static_cast<std::size_t>(b)]));
    CarryOutMerges(gaussians, rows_of(b), weights, plan, view, first[static_cast<std::size_t>(b)]);
  });
  return out;
}

}  // namespace gsut
