// Row operations on parameters and moments.
#include "gsut/optimize/training_state.h"

#include <algorithm>
#include <cstring>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

struct Column {
  float* data;
  std::int64_t width;
};

// The arrays of a view with their widths.
struct Columns {
  explicit Columns(const GaussiansView<float>& view)
      : all{{view.means, 3},
            {view.quats, 4},
            {view.log_scales, 3},
            {view.opacity_logits, 1},
            {view.sh, 3 * std::int64_t{view.sh_coefficients}}} {}
  Column all[5];
};

// An exponent of all ones is infinity or no number: one integer comparison, in vectors.
bool IsFinite(float value) {
  constexpr std::uint32_t kExponent = 0x7f800000u;
  std::uint32_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return (bits & kExponent) != kExponent;
}

}  // namespace

void CheckState(const TrainingState& state) {
  if (state.size < 0 || state.size > state.capacity) {
    throw InputError("number of Gaussians is " + std::to_string(state.size) +
                     "; the arrays hold 0 to " + std::to_string(state.capacity));
  }
  if (state.params.sh_coefficients != state.moment1.sh_coefficients ||
      state.params.sh_coefficients != state.moment2.sh_coefficients) {
    throw InputError(
        "sh of parameters and moments have " + std::to_string(state.params.sh_coefficients) + ", " +
        std::to_string(state.moment1.sh_coefficients) + " and " +
        std::to_string(state.moment2.sh_coefficients) + " coefficients; they must be the same");
  }
}

void CheckCapacity(const TrainingState& state, std::int64_t rows, const std::string& what) {
  if (rows > state.capacity) {
    throw InputError(what + " needs a capacity of " + std::to_string(rows) +
                     " rows, the arrays have " + std::to_string(state.capacity) +
                     "; grow them and call again");
  }
}

void CopyParams(const GaussiansView<float>& params, std::int64_t from, std::int64_t to) {
  for (const Column& column : Columns(params).all) {
    std::copy_n(column.data + from * column.width, column.width, column.data + to * column.width);
  }
}

// A row is a Gaussian's parameters with both of its moments.
void CopyRow(const TrainingState& state, std::int64_t from, std::int64_t to) {
  CopyParams(state.params, from, to);
  CopyParams(state.moment1, from, to);
  CopyParams(state.moment2, from, to);
}

void ZeroMoments(const TrainingState& state, std::int64_t row) {
  for (const auto* moments : {&state.moment1, &state.moment2}) {
    for (const Column& column : Columns(*moments).all) {
      std::fill_n(column.data + row * column.width, column.width, 0.0f);
    }
  }
}

// Nothing recovers from a NaN, so callers replace such rows.
bool RowIsFinite(const GaussiansView<float>& params, std::int64_t row) {
  for (const Column& column : Columns(params).all) {
    for (std::int64_t i = row * column.width; i < (row + 1) * column.width; ++i) {
      if (!IsFinite(column.data[i])) return false;
    }
  }
  return true;
}

}  // namespace gsut
