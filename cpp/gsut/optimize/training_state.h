// The arrays that densification edits in place: parameters and Adam moments with spare rows.
#pragma once

#include <cstdint>
#include <string>

#include "gsut/gaussians/gaussians.h"

namespace gsut {

// Arrays of `capacity` rows owned by somebody else (numpy); the first `size` rows are alive, what
// the others hold means nothing. moment1 and moment2 are Adam's, in the shape of the parameters.
struct TrainingState {
  std::int64_t size = 0;
  std::int64_t capacity = 0;
  GaussiansView<float> params;
  GaussiansView<float> moment1;
  GaussiansView<float> moment2;
};

// Throws InputError unless 0 <= size <= capacity and the three views agree in their coefficients.
void CheckState(const TrainingState& state);

// Throws InputError naming the capacity that is needed if `rows` rows do not fit.
void CheckCapacity(const TrainingState& state, std::int64_t rows, const std::string& what);

// Copies one row of parameters, moments left alone.
void CopyParams(const GaussiansView<float>& params, std::int64_t from, std::int64_t to);

// Copies one row of parameters and moments.
void CopyRow(const TrainingState& state, std::int64_t from, std::int64_t to);

// Sets one row of both moments to zero.
void ZeroMoments(const TrainingState& state, std::int64_t row);

// True unless one of the row's parameters is NaN or infinite. Looks at the bits: no compiler flag
// can turn it off.
bool RowIsFinite(const GaussiansView<float>& params, std::int64_t row);

// Random numbers: what a stream is for (high half) and the training step (low half).
enum class RandomUse : std::uint64_t {
  kMcmcDraw = 0x6d636d63u,       // which Gaussians are copied
  kMcmcPlace = 0x6d636d64u,      // where the copies go
  kMcmcNoise = 0x6d636d65u,      // exploration noise
  kAdaptiveSplit = 0x61646173u,  // where the halves of a split go
  kHerdStart = 0x68657264u,      // first centres of a block (step: the block)
};
constexpr std::uint64_t RandomStream(RandomUse use, std::int64_t step) {
  return static_cast<std::uint64_t>(use) << 32 | (static_cast<std::uint64_t>(step) & 0xffffffffu);
}

}  // namespace gsut
