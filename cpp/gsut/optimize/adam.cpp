// The Adam step, compiled once per instruction set.
#include "gsut/optimize/adam.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/optimize/adam.cpp"
#include "gsut/base/hwy_targets.h"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#ifndef GSUT_OPTIMIZE_ADAM_ONCE
#define GSUT_OPTIMIZE_ADAM_ONCE
#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#endif  // GSUT_OPTIMIZE_ADAM_ONCE

#include "gsut/gaussians/adam-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace {

using D = AdamTag;
using V = hn::Vec<D>;

// Adam (Kingma and Ba, "Adam: a method for stochastic optimization", 2015), element by element:
//   m = b1 m + (1 - b1) g,   v = b2 v + (1 - b2) g^2,
//   p = p - rate / (1 - b1^t) m / (sqrt(v / (1 - b2^t)) + epsilon),
// with all that does not depend on the element in AdamConstants. An element reads 16 bytes and
// writes 12 for a dozen operations, so memory decides the time: rows that no pixel saw (sparse
// Adam) are best not touched at all. A group has one of three ways through its rows:
//   1. every row, one rate: the arrays as they lie, without a look at rows (UpdateRange);
//   2. narrow rows: 16 at a time, several rows a vector, masked by what was seen (UpdateBlocks);
//   3. wide rows (harmonics): one at a time, where a skipped row saves its memory.

// 16 rows are a whole number of vectors of any instruction set, whatever the columns.
constexpr std::int64_t kBlockRows = 16;
// Rows of more columns are stepped one at a time, so that what is not seen is not even read.
constexpr std::size_t kNarrowColumns = 16;

// As UpdateRange with a rate an element, for the elements of those of 16 rows whose byte of
// `visible` is not 0. row_of: the row of each element.
void UpdateSeen(const AdamConstants& c, std::size_t count, const float* rates,
                const std::uint8_t* row_of, const std::uint8_t* visible, const float* gradients,
                float* params, float* moment1, float* moment2) {
  const D d;
  const hn::RebindToSigned<D> di;
  const hn::Rebind<std::uint8_t, D> du;
  const auto rows = hn::LoadU(hn::FixedTag<std::uint8_t, kBlockRows>(), visible);
  // The byte of each element's row is looked up in a register of 16, then widened to a mask.
  for (std::size_t i = 0; i < count; i += hn::Lanes(d)) {
    const auto seen = hn::PromoteTo(di, hn::TableLookupBytes(rows, hn::LoadU(du, row_of + i)));
    const auto mask = hn::RebindMask(d, hn::Ne(seen, hn::Zero(di)));
    if (hn::AllFalse(d, mask)) continue;
    const V p0 = hn::LoadU(d, params + i);
    const V m0 = hn::LoadU(d, moment1 + i);
    const V v0 = hn::LoadU(d, moment2 + i);
    V p = p0, m = m0, v = v0;
    UpdateVector(d, c, hn::LoadU(d, rates + i), hn::LoadU(d, gradients + i), p, m, v);
    hn::StoreU(hn::IfThenElse(mask, p, p0), d, params + i);
    hn::StoreU(hn::IfThenElse(mask, m, m0), d, moment1 + i);
    hn::StoreU(hn::IfThenElse(mask, v, v0), d, moment2 + i);
  }
}

// Narrow rows [begin, end), whole blocks only, several rows a vector; returns where it stopped.
std::int64_t UpdateBlocks(const AdamConstants& c, const AdamGroup& group, const float* rates,
                          bool many_rates, const std::uint8_t* visible, std::int64_t begin,
                          std::int64_t end) {
  const auto columns = static_cast<std::size_t>(group.columns);
  const std::size_t count = kBlockRows * columns;
  // Rates and rows of the elements of a block are the same for all blocks.
  float block_rates[kBlockRows * kNarrowColumns];
  std::uint8_t row_of[kBlockRows * kNarrowColumns];
  for (std::size_t i = 0; i < count; ++i) {
    block_rates[i] = rates[many_rates ? i % columns : 0];
    row_of[i] = static_cast<std::uint8_t>(i / columns);
  }
  constexpr std::uint8_t kAll[kBlockRows] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
  std::int64_t row = begin;
  for (; row + kBlockRows <= end; row += kBlockRows) {
    const std::size_t at = static_cast<std::size_t>(row) * columns;
    UpdateSeen(c, count, block_rates, row_of, visible == nullptr ? kAll : visible + row,
               group.gradients + at, group.params + at, group.moment1 + at, group.moment2 + at);
  }
  return row;
}

// Rows [begin, end) of one group.
void UpdateRows(const AdamConstants& c, const AdamGroup& group, const float* rates, bool many_rates,
                const std::uint8_t* visible, std::int64_t begin, std::int64_t end) {
  const auto columns = static_cast<std::size_t>(group.columns);
  const auto active = static_cast<std::size_t>(group.active_columns);
  const auto update = [&](std::size_t at, std::size_t count) HWY_ATTR {
    const auto function = many_rates ? UpdateRange<true> : UpdateRange<false>;
    function(c, count, rates, group.gradients + at, group.params + at, group.moment1 + at,
             group.moment2 + at);
  };
  // The fastest way first: no masks, no rates an element.
  if (active == columns && !many_rates && visible == nullptr) {
    update(static_cast<std::size_t>(begin) * columns,
           static_cast<std::size_t>(end - begin) * columns);
    return;
  }
  if (active == columns && columns <= kNarrowColumns) {
    begin = UpdateBlocks(c, group, rates, many_rates, visible, begin, end);
  }
  for (std::int64_t row = begin; row < end; ++row) {
    if (visible != nullptr && visible[row] == 0) continue;
    update(static_cast<std::size_t>(row) * columns, active);
  }
}

}  // namespace

void AdamRows(const AdamConstants& constants, const AdamGroup& group, const float* rates,
              bool many_rates, const std::uint8_t* visible, std::int64_t begin, std::int64_t end) {
  UpdateRows(constants, group, rates, many_rates, visible, begin, end);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
namespace {

HWY_EXPORT(AdamRows);

void Check(const std::vector<AdamGroup>& groups, std::int64_t step, const AdamOptions& options) {
  if (step < 1) {
    throw InputError("Adam step is " + std::to_string(step) + "; steps count from 1");
  }
  const auto is_rate = [](double beta) { return beta >= 0.0 && beta < 1.0; };
  if (!is_rate(options.beta1) || !is_rate(options.beta2) || !(options.epsilon >= 0.0)) {
    throw InputError("Adam needs 0 <= beta1, beta2 < 1 and epsilon >= 0, found beta1 " +
                     std::to_string(options.beta1) + ", beta2 " + std::to_string(options.beta2) +
                     ", epsilon " + std::to_string(options.epsilon));
  }
  for (std::size_t i = 0; i < groups.size(); ++i) {
    const AdamGroup& group = groups[i];
    const std::string name = "Adam group " + std::to_string(i);
    if (group.columns < 1 || group.active_columns < 1 || group.active_columns > group.columns) {
      throw InputError(name + " has " + std::to_string(group.active_columns) +
                       " active columns of " + std::to_string(group.columns) +
                       "; give 1 to the number of columns");
    }
    const std::size_t rates = group.learning_rates.size();
    if (rates != 1 && rates != static_cast<std::size_t>(group.active_columns)) {
      throw InputError(name + " has " + std::to_string(rates) + " learning rates for " +
                       std::to_string(group.active_columns) +
                       " active columns; give one, or one a column");
    }
    for (const double rate : group.learning_rates) {
      if (!std::isfinite(rate)) throw InputError(name + " has a learning rate that is not finite");
    }
  }
}

// 1 - beta^step: moments start at 0, and after `step` updates with rate 1 - beta their weights add
// up to this. Dividing by it makes them means (Kingma and Ba, 2015, section 3).
double Correction(double beta, std::int64_t step) {
  return 1.0 - std::pow(beta, static_cast<double>(step));
}

AdamConstants ConstantsOf(std::int64_t step, const AdamOptions& options) {
  return {static_cast<float>(options.beta1),
          static_cast<float>(1.0 - options.beta1),
          static_cast<float>(options.beta2),
          static_cast<float>(1.0 - options.beta2),
          static_cast<float>(1.0 / std::sqrt(Correction(options.beta2, step))),
          static_cast<float>(options.epsilon)};
}

std::vector<float> RatesOf(const AdamGroup& group, std::int64_t step, const AdamOptions& options) {
  const double correction = Correction(options.beta1, step);
  std::vector<float> rates;
  rates.reserve(group.learning_rates.size());
  for (const double rate : group.learning_rates) {
    rates.push_back(static_cast<float>(rate / correction));
  }
  return rates;
}

}  // namespace

void AdamStep(const std::vector<AdamGroup>& groups, std::int64_t rows, std::int64_t step,
              const std::uint8_t* visible, const AdamOptions& options) {
  Check(groups, step, options);
  const AdamConstants constants = ConstantsOf(step, options);
  const auto rows_function = HWY_DYNAMIC_DISPATCH(AdamRows);
  for (const AdamGroup& group : groups) {
    const std::vector<float> rates = RatesOf(group, step, options);
    // Schedules often give all columns one rate.
    const bool same =
        std::all_of(rates.begin(), rates.end(), [&](float rate) { return rate == rates.front(); });
    constexpr std::int64_t kChunkElements = 16384;  // 64 KiB of each of the four arrays
    constexpr std::int64_t kFewestRows = 16;        // a cache line of each column's floats
    const std::int64_t chunk_rows =
        std::max<std::int64_t>(kFewestRows, kChunkElements / group.columns);
    ParallelFor(rows, chunk_rows, [&](std::int64_t begin, std::int64_t end) {
      rows_function(constants, group, rates.data(), !same, visible, begin, end);
    });
  }
}

HarmonicsStep MakeHarmonicsStep(const AdamGroup& group, std::int64_t step,
                                const AdamOptions& options) {
  Check({group}, step, options);
  HarmonicsStep out = {ConstantsOf(step, options),
                       group.params,
                       group.moment1,
                       group.moment2,
                       group.active_columns,
                       {}};
  if (group.columns > static_cast<int>(out.rates.size())) {
    throw InputError("harmonics have " + std::to_string(group.columns) + " columns; at most " +
                     std::to_string(out.rates.size()) + " can be stepped");
  }
  const std::vector<float> rates = RatesOf(group, step, options);
  for (int i = 0; i < group.active_columns; ++i) {
    out.rates[static_cast<std::size_t>(i)] =
        rates[rates.size() == 1 ? 0 : static_cast<std::size_t>(i)];
  }
  return out;
}

}  // namespace gsut
#endif  // HWY_ONCE
