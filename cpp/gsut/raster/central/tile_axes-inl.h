// Records from the camera's frame into a tile's, and gradients back.

#if defined(GSUT_RASTER_CENTRAL_TILE_AXES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CENTRAL_TILE_AXES_INL_H_
#undef GSUT_RASTER_CENTRAL_TILE_AXES_INL_H_
#else
#define GSUT_RASTER_CENTRAL_TILE_AXES_INL_H_
#endif

#include <hwy/cache_control.h>

#include "gsut/raster/sharp_records.h"
#include "gsut/raster/tile_math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// The tile's axes, ready to turn linear forms between the camera frame and the tile's (1, s, t).
// Forms are 3 x 3 floats at the head of 16; the tail is copied.
class TileAxes {
 public:
  // axes[k][j]: component j of the k-th row to multiply with: D, E1, E2, or their transpose.
  HWY_INLINE explicit TileAxes(const float (*axes)[3]) {
#if HWY_MAX_BYTES == 64
    const FloatTag d;
    HWY_ALIGN float factors[3][16];
    HWY_ALIGN std::int32_t source[3][16];
    for (int lane = 0; lane < 16; ++lane) {
      for (int j = 0; j < 3; ++j) {
        const bool is_form = lane < 9;
        factors[j][lane] = is_form ? axes[lane % 3][j] : j == 0 ? 1.0f : 0.0f;
        source[j][lane] = is_form ? lane / 3 * 3 + j : lane;
      }
    }
    for (int j = 0; j < 3; ++j) {
      factors_[j] = hn::Load(d, factors[j]);
      hn::Store(hn::Load(hn::RebindToSigned<FloatTag>(), source[j]), hn::RebindToSigned<FloatTag>(),
                source_[j]);
    }
    for (int lane = 0; lane < 16; ++lane) {
      along_center_[lane] = lane < 9 && lane % 3 == 0 ? 1.0f : 0.0f;
      one_[lane] = lane == record::kC ? 1.0f : 0.0f;
      sign_[lane] = lane == record::kDepth ? -1.0f : 1.0f;
    }
#else
    const Float4 d;
    for (int j = 0; j < 3; ++j) {
      HWY_ALIGN const float column[4] = {axes[0][j], axes[1][j], axes[2][j], 0.0f};
      columns_[j] = hn::Load(d, column);
    }
#endif
  }

  // With 16 lanes the three forms are one vector: three permutations and three products turn all of
  // them. Without, a form is a vector of four lanes; out is written front to back, as each store's
  // last lane is overwritten by the next.
  // out[3 f + k] = sum over j of axes[k][j] in[3 f + j] for the three forms f.
  HWY_INLINE void Turn(const float* HWY_RESTRICT in, float* HWY_RESTRICT out) const {
#if HWY_MAX_BYTES == 64
    const FloatTag d;
    const FloatVec v = hn::Load(d, in);
    FloatVec sum = hn::Mul(Pick(v, 0), factors_[0]);
    sum = hn::MulAdd(Pick(v, 1), factors_[1], sum);
    hn::Store(hn::MulAdd(Pick(v, 2), factors_[2], sum), d, out);
#else
    const Float4 d;
    hn::Vec<Float4> form[3];
    for (int k = 0; k < 3; ++k) {
      form[k] = hn::MulAdd(hn::Set(d, in[3 * k + 2]), columns_[2],
                           hn::MulAdd(hn::Set(d, in[3 * k + 1]), columns_[1],
                                      hn::Mul(hn::Set(d, in[3 * k]), columns_[0])));
    }
    const auto tail0 = hn::LoadU(d, in + 9);
    const auto tail1 = hn::Load(d, in + 12);
    hn::StoreU(form[0], d, out);
    hn::StoreU(form[1], d, out + 3);
    hn::StoreU(form[2], d, out + 6);
    hn::StoreU(tail0, d, out + 9);
    hn::Store(tail1, d, out + 12);
#endif
  }

  // f.D = f.(D - n) + f.n, where n is the mean's direction: f.n is known exactly (0, 0 and 1 for a,
  // b and c), and D - n is a difference of two pairs of floats.
  // Turn for a sharp record, see kSharpForm; center, direction: D and n of kDirectionSize floats.
  HWY_INLINE void TurnSharp(const float* HWY_RESTRICT in, const float* HWY_RESTRICT center,
                            const float* HWY_RESTRICT direction, float* HWY_RESTRICT out) const {
    const Float4 d4;
    HWY_ALIGN float delta[4];
    hn::Store(hn::Add(hn::Sub(hn::Load(d4, center), hn::Load(d4, direction)),
                      hn::Sub(hn::Load(d4, center + 4), hn::Load(d4, direction + 4))),
              d4, delta);
#if HWY_MAX_BYTES == 64
    const FloatTag d;
    const FloatVec v = hn::Mul(hn::Load(d, in), hn::Load(d, sign_));
    const FloatMask along_center = hn::Gt(hn::Load(d, along_center_), hn::Zero(d));
    FloatVec sum = hn::Load(d, one_);
    for (int j = 0; j < 3; ++j) {
      const FloatVec factor = hn::IfThenElse(along_center, hn::Set(d, delta[j]), factors_[j]);
      sum = hn::MulAdd(Pick(v, j), factor, sum);
    }
    hn::Store(sum, d, out);
#else
    Turn(in, out);
    for (int form = 0; form < 9; form += 3) {
      out[form] = in[form] * delta[0] + in[form + 1] * delta[1] + in[form + 2] * delta[2];
    }
    out[record::kC] += 1.0f;
    out[record::kDepth] = -out[record::kDepth];
#endif
  }

 private:
#if HWY_MAX_BYTES == 64
  HWY_INLINE FloatVec Pick(FloatVec v, int j) const {
    const FloatTag d;
    return hn::TableLookupLanes(v, hn::SetTableIndices(d, source_[j]));
  }
  FloatVec factors_[3];
  HWY_ALIGN std::int32_t source_[3][16];
  HWY_ALIGN float along_center_[16];  // 1 in the lanes of a.D, b.D and c.D
  HWY_ALIGN float one_[16];           // 1 in the lane of c.D
  HWY_ALIGN float sign_[16];          // -1 in the lane of the depth
#else
  hn::Vec<Float4> columns_[3];
#endif
};

// From the camera frame into the tile's, and (gradients) back.
HWY_INLINE TileAxes ToTileAxes(const TileGrid& grid, int tile) {
  float axes[3][3];
  for (int k = 0; k < 3; ++k) {
    for (int j = 0; j < 3; ++j)
      axes[k][j] = grid.bundles[static_cast<std::size_t>(tile)].values[3 * k + j];
  }
  return TileAxes(axes);
}

HWY_INLINE TileAxes FromTileAxes(const TileGrid& grid, int tile) {
  float axes[3][3];
  for (int k = 0; k < 3; ++k) {
    for (int j = 0; j < 3; ++j)
      axes[k][j] = grid.bundles[static_cast<std::size_t>(tile)].values[3 * j + k];
  }
  return TileAxes(axes);
}

// Fetches what TurnRecord will need beside the record, which must have been fetched before.
HWY_INLINE void FetchDirection(const Frame& frame, std::size_t gaussian) {
  if (frame.records[record::kSize * gaussian + record::kDepth] < 0.0f) {
    hwy::Prefetch(&frame.mean_direction[kDirectionSize * gaussian]);
  }
}

// The record of a Gaussian in the tile's frame; center: of the tile.
HWY_INLINE void TurnRecord(const TileAxes& to_tile, const float* center, const Frame& frame,
                           std::size_t gaussian, float* out) {
  const float* r = &frame.records[record::kSize * gaussian];
  if (r[record::kDepth] < 0.0f) {
    to_tile.TurnSharp(r, center, &frame.mean_direction[kDirectionSize * gaussian], out);
  } else {
    to_tile.Turn(r, out);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
