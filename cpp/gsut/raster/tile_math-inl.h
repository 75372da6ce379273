// Steps that the forward and the backward pass of a tile share: records into the tile's frame, and
// which blocks of the tile a Gaussian can touch.

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
#define GSUT_UNROLL _Pragma("GCC unroll 8")

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

inline constexpr int kBlocks = kTilePixels / kLanes;
inline constexpr int kBlockStride = (kBlocks + kLanes - 1) / kLanes * kLanes;

using Float4 = hn::FixedTag<float, 4>;

// The tile's axes, ready to turn linear forms between the camera frame and the tile's (1, s, t).
class TileAxes {
 public:
  HWY_INLINE TileAxes(const TileGrid& grid, int tile) {
    const Float4 d;
    for (int k = 0; k < 3; ++k) {
      HWY_ALIGN const float to[4] = {grid.frame[k][tile], grid.frame[3 + k][tile],
                                     grid.frame[6 + k][tile], 0.0f};
      to_tile_[k] = hn::Load(d, to);
      HWY_ALIGN const float from[4] = {grid.frame[3 * k][tile], grid.frame[3 * k + 1][tile],
                                       grid.frame[3 * k + 2][tile], 0.0f};
      from_tile_[k] = hn::Load(d, from);
    }
  }

  // record (camera frame) -> out (tile frame): a.D, a.E1, a.E2, b.D, ...; the rest is copied.
  HWY_INLINE void ToTile(const float* record, float* out) const { Turn(to_tile_, record, out); }

  // Gradients to tile-frame forms -> gradients to camera-frame forms; the rest is copied.
  HWY_INLINE void FromTile(const float* sums, float* out) const { Turn(from_tile_, sums, out); }

 private:
  static HWY_INLINE void Turn(const hn::Vec<Float4>* axes, const float* in, float* out) {
    const Float4 d;
    hn::Vec<Float4> form[3];
    for (int k = 0; k < 3; ++k) {
      form[k] = hn::MulAdd(hn::Set(d, in[3 * k]), axes[0],
                           hn::MulAdd(hn::Set(d, in[3 * k + 1]), axes[1],
                                      hn::Mul(hn::Set(d, in[3 * k + 2]), axes[2])));
    }
    const auto tail0 = hn::LoadU(d, in + 9);
    const auto tail1 = hn::Load(d, in + 12);
    hn::StoreU(form[0], d, out);
    hn::StoreU(form[1], d, out + 3);
    hn::StoreU(form[2], d, out + 6);
    hn::StoreU(tail0, d, out + 9);
    hn::Store(tail1, d, out + 12);
  }

  hn::Vec<Float4> to_tile_[3], from_tile_[3];
};

// Bit b set where block b may hold a pixel with N < z^2, z > 0: interval bounds over the block's box.
HWY_INLINE std::uint64_t TouchedBlocks(const float* r, const float* boxes) {
  const FloatTag d;
  const auto zero = hn::Zero(d);
  std::uint64_t blocks = 0;
  const auto value = [&](int form, FloatVec s, FloatVec t) HWY_ATTR {
    return hn::MulAdd(hn::Set(d, r[form + 1]), s,
                      hn::MulAdd(hn::Set(d, r[form + 2]), t, hn::Set(d, r[form])));
  };
  const auto spread = [&](int form, FloatVec hs, FloatVec ht) HWY_ATTR {
    return hn::MulAdd(hn::Abs(hn::Set(d, r[form + 1])), hs,
                      hn::Mul(hn::Abs(hn::Set(d, r[form + 2])), ht));
  };
  for (int b = 0; b < kBlockStride; b += kLanes) {
    const auto s = hn::Load(d, boxes + b);
    const auto t = hn::Load(d, boxes + kBlockStride + b);
    const auto hs = hn::Load(d, boxes + 2 * kBlockStride + b);
    const auto ht = hn::Load(d, boxes + 3 * kBlockStride + b);
    const auto p = hn::Max(hn::Sub(hn::Abs(value(record::kA, s, t)), spread(record::kA, hs, ht)), zero);
    const auto q = hn::Max(hn::Sub(hn::Abs(value(record::kB, s, t)), spread(record::kB, hs, ht)), zero);
    const auto z = hn::Max(hn::Add(value(record::kC, s, t), spread(record::kC, hs, ht)), zero);
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

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
