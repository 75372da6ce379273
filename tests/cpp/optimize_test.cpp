// Tests gsut/optimize: Adam on every instruction set; the rest is tested from Python.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "gsut/base/isa.h"
#include "gsut/optimize/adam.h"

namespace gsut {
namespace {

// Of the update, had moment and gradient the same sign: a dozen float operations on constants
// rounded to float, 6e-8 each.
constexpr double kAdamRelative = 4e-7;
constexpr double kFloatEpsilon = 1.2e-7;

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

}  // namespace
}  // namespace gsut
