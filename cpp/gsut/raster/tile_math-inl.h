// Steps that the tile kernels share: which blocks of a tile a Gaussian can touch, and sums of
// lanes.

#if defined(GSUT_RASTER_TILE_MATH_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_TILE_MATH_INL_H_
#undef GSUT_RASTER_TILE_MATH_INL_H_
#else
#define GSUT_RASTER_TILE_MATH_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/tile_grid.h"

// Fully unrolls the loop over the Gaussians (or blocks) that are worked on together.
#define GSUT_UNROLL _Pragma("GCC unroll 16")
// Follows the parameters of a lambda whose arguments are constants only once it is inlined.
#define GSUT_INLINED_LAMBDA HWY_ATTR __attribute__((always_inline))

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

inline constexpr int kBlocks = kTilePixels / kLanes;
inline constexpr int kBlockStride = (kBlocks + kLanes - 1) / kLanes * kLanes;

using Float4 = hn::FixedTag<float, 4>;

// form[0] + form[1] s + form[2] t: a linear form of the rays (1, s, t) of a tile.
HWY_INLINE FloatVec LinearForm(const float* form, FloatVec s, FloatVec t) {
  const FloatTag d;
  return hn::MulAdd(hn::Set(d, form[1]), s,
                    hn::MulAdd(hn::Set(d, form[2]), t, hn::Set(d, form[0])));
}

// Bit b set where block b may hold a pixel with N < z^2, z > 0: interval bounds over the block's
// box.
HWY_INLINE std::uint64_t TouchedBlocks(const float* r, const float* boxes) {
  const FloatTag d;
  const auto zero = hn::Zero(d);
  std::uint64_t blocks = 0;
  const auto spread = [&](int form, FloatVec hs, FloatVec ht) HWY_ATTR {
    return hn::MulAdd(hn::Abs(hn::Set(d, r[form + 1])), hs,
                      hn::Mul(hn::Abs(hn::Set(d, r[form + 2])), ht));
  };
  for (int b = 0; b < kBlockStride; b += kLanes) {
    const auto s = hn::Load(d, boxes + b);
    const auto t = hn::Load(d, boxes + kBlockStride + b);
    const auto hs = hn::Load(d, boxes + 2 * kBlockStride + b);
    const auto ht = hn::Load(d, boxes + 3 * kBlockStride + b);
    const auto p = hn::Max(
        hn::Sub(hn::Abs(LinearForm(r + record::kA, s, t)), spread(record::kA, hs, ht)), zero);
    const auto q = hn::Max(
        hn::Sub(hn::Abs(LinearForm(r + record::kB, s, t)), spread(record::kB, hs, ht)), zero);
    const auto z =
        hn::Max(hn::Add(LinearForm(r + record::kC, s, t), spread(record::kC, hs, ht)), zero);
    const auto hit = hn::Lt(hn::MulAdd(p, p, hn::Mul(q, q)), hn::Mul(z, z));
    blocks |= MaskBits(hit) << b;
  }
  return blocks;
}

// Bit matrix of 8 x 8 stored as 8 bytes: transposed by three exchanges.
HWY_INLINE std::uint64_t TransposeBits8x8(std::uint64_t x) {
  std::uint64_t y = (x ^ (x >> 7)) & 0x00AA00AA00AA00AAULL;
  x ^= y ^ (y << 7);
  y = (x ^ (x >> 14)) & 0x0000CCCC0000CCCCULL;
  x ^= y ^ (y << 14);
  y = (x ^ (x >> 28)) & 0x00000000F0F0F0F0ULL;
  return x ^ y ^ (y << 28);
}

// blocks_of[j], j < 64: blocks of Gaussian j -> gaussians_of[b], b < kBlocks: Gaussians of block b.
HWY_INLINE void TransposeMasks(const std::uint64_t* blocks_of, std::uint64_t* gaussians_of) {
  for (int b = 0; b < kBlocks; ++b) gaussians_of[b] = 0;
  for (int j = 0; j < 64; j += 8) {
    for (int b = 0; b < kBlocks; b += 8) {
      std::uint64_t bits = 0;
      for (int i = 0; i < 8; ++i) bits |= ((blocks_of[j + i] >> b) & 0xFF) << (8 * i);
      bits = TransposeBits8x8(bits);
      for (int i = 0; i < 8; ++i) gaussians_of[b + i] |= ((bits >> (8 * i)) & 0xFF) << j;
    }
  }
}

// Adds neighbours: result lane 2 i = x's lanes 2 i and 2 i + 1, lane 2 i + 1 = y's.
HWY_INLINE FloatVec AddPairs1(FloatVec x, FloatVec y) {
  return hn::Add(hn::OddEven(y, x), hn::Shuffle2301(hn::OddEven(x, y)));
}

// The same for pairs of lanes, and for blocks of four.
HWY_INLINE FloatVec AddPairs2(FloatVec x, FloatVec y) {
  const FloatTag d;
  const hn::Repartition<double, FloatTag> dd;
  const auto x2 = hn::BitCast(dd, x);
  const auto y2 = hn::BitCast(dd, y);
  const auto swapped = hn::Shuffle01(hn::OddEven(x2, y2));
  return hn::Add(hn::BitCast(d, hn::OddEven(y2, x2)), hn::BitCast(d, swapped));
}

HWY_INLINE FloatVec AddPairs4(FloatVec x, FloatVec y) {
  return hn::Add(hn::OddEvenBlocks(y, x), hn::SwapAdjacentBlocks(hn::OddEvenBlocks(x, y)));
}

// The sums of kCount vectors, a multiple of kLanes, in order, into out[kCount]. One shuffle a pair.
template <int kCount>
HWY_INLINE void SumLanes(const FloatVec* v, float* out) {
  const FloatTag d;
  for (int group = 0; group < kCount; group += kLanes) {
    FloatVec w[kLanes];
    GSUT_UNROLL for (int i = 0; i < kLanes; ++i) w[i] = v[group + i];
#if HWY_MAX_BYTES == 64
    GSUT_UNROLL for (int i = 0; i < 8; ++i) {
      w[i] =
          hn::Add(hn::ConcatUpperLower(d, w[i + 8], w[i]), hn::ConcatLowerUpper(d, w[i + 8], w[i]));
    }
#endif
    if constexpr (kLanes >= 8) {
      GSUT_UNROLL for (int i = 0; i < 4; ++i) w[i] = AddPairs4(w[i], w[i + 4]);
    }
    GSUT_UNROLL for (int i = 0; i < 2; ++i) w[i] = AddPairs2(w[i], w[i + 2]);
    hn::Store(AddPairs1(w[0], w[1]), d, out + group);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
