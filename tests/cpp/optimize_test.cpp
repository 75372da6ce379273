// Tests gsut/optimize: Adam on every instruction set, MCMC and adaptive densification.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"
#include "gsut/gaussians/activations.h"
#include "gsut/optimize/adam.h"
#include "gsut/optimize/adaptive.h"
#include "gsut/optimize/mcmc.h"

namespace gsut {
namespace {

// Of the update, had moment and gradient the same sign: a dozen float operations on constants
// rounded to float, 6e-8 each.
constexpr double kAdamRelative = 4e-7;
constexpr double kFloatEpsilon = 1.2e-7;
constexpr int kThreads[] = {1, 2, 8};

struct AdamData {
  std::vector<float> params, gradients, moment1, moment2;
  AdamData(std::size_t count, unsigned seed) {
    std::mt19937_64 engine(seed);
    std::normal_distribution<float> normal;
    std::uniform_real_distribution<float> exponent(-9, 1);
    for (std::size_t i = 0; i < count; ++i) {
      params.push_back(normal(engine));
      gradients.push_back(normal(engine) * std::pow(10.0f, exponent(engine)));
      moment1.push_back(normal(engine) * 0.1f * std::abs(gradients.back()));
      moment2.push_back(0.01f * gradients.back() * gradients.back());
    }
  }
};

constexpr double kRates[2] = {1e-2, 3e-4};

// Double arithmetic on the float inputs; wide: the first three columns have rate 0, the rest
// rate 1.
void ReferenceAdam(const AdamData& in, int columns, int active, const std::uint8_t* visible,
                   std::int64_t step, bool wide, std::vector<double>* params,
                   std::vector<double>* moment1, std::vector<double>* moment2,
                   std::vector<double>* magnitudes) {
  const AdamOptions options;
  for (std::size_t i = 0; i < in.params.size(); ++i) {
    const std::size_t row = i / static_cast<std::size_t>(columns);
    const int column = static_cast<int>(i % static_cast<std::size_t>(columns));
    params->push_back(in.params[i]);
    moment1->push_back(in.moment1[i]);
    moment2->push_back(in.moment2[i]);
    magnitudes->push_back(0);
    if (column >= active || (visible != nullptr && visible[row] == 0)) continue;
    const double g = in.gradients[i];
    const double m = options.beta1 * in.moment1[i] + (1 - options.beta1) * g;
    const double v = options.beta2 * in.moment2[i] + (1 - options.beta2) * g * g;
    const double rate = wide && column >= 3 ? kRates[1] : kRates[0];
    const double t = static_cast<double>(step);
    const double factor = rate / (1 - std::pow(options.beta1, t)) /
                          (std::sqrt(v / (1 - std::pow(options.beta2, t))) + options.epsilon);
    params->back() -= factor * m;
    magnitudes->back() =
        factor * (options.beta1 * std::abs(in.moment1[i]) + (1 - options.beta1) * std::abs(g));
    moment1->back() = m;
    moment2->back() = v;
  }
}

TEST(AdamTest, MatchesDoubleReferenceOnEveryInstructionSetWithTheSameBits) {
  struct Case {
    std::int64_t rows;
    int columns, active;
    bool masked, wide;
  };
  std::vector<Case> cases;
  for (const std::int64_t rows : {0, 1, 15, 16, 17, 1000, 7001}) {
    for (const int columns : {1, 3, 4}) {
      cases.push_back({rows, columns, columns, false, false});
      cases.push_back({rows, columns, columns, true, false});
    }
    cases.push_back({rows, 12, 12, true, true});
    cases.push_back({rows, 12, 12, false, true});
    for (const int active : {3, 12, 27, 48}) {
      cases.push_back({rows, 48, active, true, true});
      cases.push_back({rows, 48, active, false, true});
    }
  }
  for (const Case& c : cases) {
    const auto count = static_cast<std::size_t>(c.rows * c.columns);
    const AdamData in(count, 5);
    std::vector<std::uint8_t> visible;
    visible.reserve(static_cast<std::size_t>(c.rows));
    for (std::int64_t i = 0; i < c.rows; ++i) visible.push_back((i * 7 + i / 5) % 3 != 0);
    const std::uint8_t* mask = c.masked ? visible.data() : nullptr;
    constexpr std::int64_t kStep = 12;
    std::vector<double> params, moment1, moment2, magnitudes;
    ReferenceAdam(in, c.columns, c.active, mask, kStep, c.wide, &params, &moment1, &moment2,
                  &magnitudes);
    std::vector<float> first;
    for (const std::string& isa : AvailableIsas()) {
      SetIsa(isa);
      AdamData data = in;
      AdamGroup group = {data.params.data(),  data.gradients.data(),
                         data.moment1.data(), data.moment2.data(),
                         c.columns,           c.active,
                         {kRates[0]}};
      if (c.wide) {
        group.learning_rates.assign(static_cast<std::size_t>(c.active), kRates[1]);
        std::fill_n(group.learning_rates.begin(), 3, kRates[0]);
      }
      AdamStep({group}, c.rows, kStep, mask);
      for (std::size_t i = 0; i < count; ++i) {
        const double tolerance =
            kAdamRelative * std::abs(magnitudes[i]) + kFloatEpsilon * std::abs(params[i]);
        ASSERT_NEAR(data.params[i], params[i], tolerance) << isa << " " << c.columns << " " << i;
        ASSERT_NEAR(data.moment1[i], moment1[i],
                    kAdamRelative * (std::abs(moment1[i]) + std::abs(in.gradients[i])));
        ASSERT_NEAR(data.moment2[i], moment2[i], kAdamRelative * moment2[i]);
        if (magnitudes[i] == 0) {
          ASSERT_EQ(data.params[i], in.params[i]);
          ASSERT_EQ(data.moment1[i], in.moment1[i]);
        }
      }
      if (first.empty()) first = data.params;
      EXPECT_EQ(first, data.params) << isa;
    }
    SetIsa("");
  }
}

TEST(AdamTest, SameBitsOnAnyThreadCount) {
  std::vector<std::vector<float>> results;
  for (const int threads : kThreads) {
    SetNumThreads(threads);
    AdamData data(3 * 20011, 6);
    std::vector<std::uint8_t> visible(20011, 1);
    for (std::size_t i = 0; i < visible.size(); i += 3) visible[i] = 0;
    for (std::int64_t step = 1; step <= 3; ++step) {
      AdamStep({{data.params.data(),
                 data.gradients.data(),
                 data.moment1.data(),
                 data.moment2.data(),
                 3,
                 3,
                 {1e-2}}},
               20011, step, visible.data());
    }
    results.push_back(data.params);
  }
  SetNumThreads(0);
  EXPECT_EQ(results[0], results[1]);
  EXPECT_EQ(results[0], results[2]);
}

TEST(AdamTest, WrongOptionsRaise) {
  float value = 0;
  const AdamGroup good = {&value, &value, &value, &value, 1, 1, {1e-2}};
  EXPECT_THROW(AdamStep({good}, 1, 0, nullptr), InputError);
  EXPECT_THROW(AdamStep({good}, 1, 1, nullptr, {1.0, 0.999, 1e-15}), InputError);
  AdamGroup bad = good;
  bad.active_columns = 2;
  EXPECT_THROW(AdamStep({bad}, 1, 1, nullptr), InputError);
  bad = good;
  bad.learning_rates = {1e-2, 1e-2};
  EXPECT_THROW(AdamStep({bad}, 1, 1, nullptr), InputError);
  bad.learning_rates = {std::numeric_limits<double>::quiet_NaN()};
  EXPECT_THROW(AdamStep({bad}, 1, 1, nullptr), InputError);
}

// A state that owns its arrays.
struct OwnedState {
  std::vector<float> arrays[3][5];
  TrainingState state;
  OwnedState(std::int64_t size, std::int64_t capacity, unsigned seed, int coefficients = 4) {
    std::mt19937_64 engine(seed);
    std::normal_distribution<float> normal;
    const std::int64_t widths[5] = {3, 4, 3, 1, 3 * std::int64_t{coefficients}};
    GaussiansView<float>* views[3] = {&state.params, &state.moment1, &state.moment2};
    for (int set = 0; set < 3; ++set) {
      for (int k = 0; k < 5; ++k) {
        arrays[set][k].resize(static_cast<std::size_t>(capacity * widths[k]));
        for (float& value : arrays[set][k]) value = normal(engine);
      }
      *views[set] = {capacity,
                     coefficients,
                     arrays[set][0].data(),
                     arrays[set][1].data(),
                     arrays[set][2].data(),
                     arrays[set][3].data(),
                     arrays[set][4].data()};
    }
    state.size = size;
    state.capacity = capacity;
  }
  bool SameBits(const OwnedState& other) const {
    for (int set = 0; set < 3; ++set) {
      for (int k = 0; k < 5; ++k) {
        const auto& a = arrays[set][k];
        const auto& b = other.arrays[set][k];
        if (a.size() != b.size()) return false;
        if (!a.empty() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) != 0) {
          return false;
        }
      }
    }
    return true;
  }
};

TEST(McmcTest, SameBitsOnAnyThreadCount) {
  std::vector<OwnedState> results;
  for (const int threads : kThreads) {
    SetNumThreads(threads);
    results.emplace_back(20000, 30000, 3);
    OwnedState& owned = results.back();
    for (int i = 0; i < 20000; i += 9) owned.state.params.opacity_logits[i] = -7;
    const std::vector<float> weights(20000, 1.0f);
    McmcOptions options;
    options.seed = 11;
    options.step = 100;
    const McmcCounts counts = McmcDensify(owned.state, 26000, weights.data(), options);
    EXPECT_EQ(counts.size, 26000);
    EXPECT_GE(counts.relocated, 2222);
    McmcNoise(owned.state.params, 26000, 1e-3, 5e5, 11, 100);
  }
  SetNumThreads(0);
  EXPECT_TRUE(results[0].SameBits(results[1]));
  EXPECT_TRUE(results[0].SameBits(results[2]));
}

TEST(McmcTest, CapacityTooSmallRaises) {
  OwnedState owned(4, 5, 3);
  const std::vector<float> weights(4, 1.0f);
  EXPECT_THROW(McmcDensify(owned.state, 6, weights.data(), {}), InputError);
}

TEST(McmcTest, RowIsFiniteFindsEveryParameter) {
  for (const float bad :
       {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(),
        -std::numeric_limits<float>::infinity()}) {
    for (int k = 0; k < 5; ++k) {
      OwnedState owned(3, 3, 3);
      ASSERT_TRUE(RowIsFinite(owned.state.params, 1));
      auto& array = owned.arrays[0][k];
      array[2 * array.size() / 3 - 1] = bad;  // the last value of row 1
      EXPECT_FALSE(RowIsFinite(owned.state.params, 1));
      EXPECT_TRUE(RowIsFinite(owned.state.params, 0));
      EXPECT_TRUE(RowIsFinite(owned.state.params, 2));
    }
  }
}

TEST(AdaptiveTest, SameBitsOnAnyThreadCount) {
  std::vector<OwnedState> results;
  for (const int threads : kThreads) {
    SetNumThreads(threads);
    results.emplace_back(20000, 45000, 3);
    OwnedState& owned = results.back();
    std::vector<float> sums(20000, 0.0f), distances(20000, 2.0f);
    std::vector<std::int32_t> counts(20000, 0);
    AccumulateDensity(20000, owned.state.moment1.means, distances.data(), nullptr, nullptr,
                      sums.data(), counts.data());
    AdaptiveOptions options;
    options.gradient_threshold = 1.0;
    options.clone_scale = 2.0;
    options.prune_opacity = 0.2;
    const AdaptivePlan plan =
        PlanAdaptive(owned.state.params, 20000, sums.data(), counts.data(), options);
    EXPECT_GT(plan.pruned, 100);
    EXPECT_GT(plan.cloned, 100);
    EXPECT_GT(plan.split, 100);
    EXPECT_EQ(ApplyAdaptive(owned.state, plan, 1, 2), plan.SizeAfter());
  }
  SetNumThreads(0);
  EXPECT_TRUE(results[0].SameBits(results[1]));
  EXPECT_TRUE(results[0].SameBits(results[2]));
}

TEST(AdaptiveTest, CapacityTooSmallNamesTheNeed) {
  OwnedState owned(2, 3, 3);
  AdaptivePlan plan;
  plan.actions = {AdaptiveAction::kClone, AdaptiveAction::kSplit};
  plan.cloned = plan.split = 1;
  try {
    ApplyAdaptive(owned.state, plan, 0, 0);
    FAIL() << "expected InputError";
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("capacity of 4"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace gsut
