// The backward pass of one tile: gradients of each pair's linear forms, opacity and colour.

#if defined(GSUT_RASTER_BACKWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_BACKWARD_INL_H_
#undef GSUT_RASTER_BACKWARD_INL_H_
#else
#define GSUT_RASTER_BACKWARD_INL_H_
#endif

#include "gsut/raster/tile_math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Blocks worked on together.
inline constexpr int kBackwardJam = 2;

// State of a tile's pixels, block by block: fields of kLanes floats.
enum PixelField {
  kFieldS,
  kFieldT,
  kFieldRed,    // dL/dred ...
  kFieldGreen,
  kFieldBlue,
  kFieldTransmittance,
  kFieldBehind,  // what lies behind the Gaussians blended so far, as L sees it
  kFieldAlong,   // dL/ddepth times the ray's length
  kNumFields
};

// Gradients of L to the image's pixels of one tile, swizzled as the tile grid.
struct PixelGradients {
  const float* color[3];
  const float* depth;  // to depth, times the ray's length; null without depth
  const float* final_transmittance;  // to the transmittance that is left
};

// The sums of 16 vectors, in order, into out[16].
HWY_INLINE void SumLanes16(FloatVec* v, float* out) {
  const FloatTag d;
  constexpr int kLevels = kLanes == 16 ? 4 : kLanes == 8 ? 3 : kLanes == 4 ? 2 : 0;
  int count = 16;
  for (int level = 0; level < kLevels; ++level) {
    count /= 2;
    for (int i = 0; i < count; ++i) {
      v[i] = hn::Add(hn::ConcatEven(d, v[2 * i + 1], v[2 * i]),
                     hn::ConcatOdd(d, v[2 * i + 1], v[2 * i]));
    }
  }
  for (int i = 0; i < count; ++i) hn::Store(v[i], d, out + i * kLanes);
}

template <bool kDepth, bool kStopBefore>
HWY_INLINE void BackwardTile(const TileGrid& grid, int tile, float alpha_max,
                             float transmittance_min, const PixelGradients& gradients,
                             Frame* frame) {
  const FloatTag d;
  const std::uint32_t count = frame->entry_count[tile];
  if (count == 0) return;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  const TileAxes axes(grid, tile);
  // One block more than the tile has: a dead block that fills up the last group.
  HWY_ALIGN float state[(kBlocks + 1) * kNumFields * kLanes];
  const auto field = [&](int block, int f) HWY_ATTR {
    return state + (block * kNumFields + f) * kLanes;
  };
  for (int b = 0; b < kBlocks; ++b) {
    const std::size_t o = pixel0 + static_cast<std::size_t>(b) * kLanes;
    hn::Store(hn::Load(d, &grid.s[o]), d, field(b, kFieldS));
    hn::Store(hn::Load(d, &grid.t[o]), d, field(b, kFieldT));
    FloatVec behind = hn::Mul(hn::Abs(hn::Load(d, &frame->transmittance[o])),
                              hn::Load(d, gradients.final_transmittance + b * kLanes));
    for (int c = 0; c < 3; ++c) {
      const FloatVec g = hn::Load(d, gradients.color[c] + b * kLanes);
      hn::Store(g, d, field(b, kFieldRed + c));
      behind = hn::MulAdd(g, hn::Load(d, &frame->color[c][o]), behind);
    }
    if (kDepth) {
      const FloatVec g = hn::Load(d, gradients.depth + b * kLanes);
      hn::Store(g, d, field(b, kFieldAlong));
      behind = hn::MulAdd(g, hn::Load(d, &frame->depth[o]), behind);
    }
    hn::Store(hn::Load(d, &grid.start[o]), d, field(b, kFieldTransmittance));
    hn::Store(behind, d, field(b, kFieldBehind));
  }
  for (int f = 0; f < kNumFields; ++f) hn::Store(hn::Zero(d), d, field(kBlocks, f));

  const FloatVec alpha_limit = hn::Set(d, alpha_max);
  const FloatVec stop = hn::Set(d, transmittance_min);
  const FloatVec one = hn::Set(d, 1.0f);
  const TileEntry* entries = &frame->entries[frame->tile_begin[tile]];
  const float* records = frame->records.data();
  constexpr double kLn2 = 0.69314718055994530942;
  constexpr std::uint32_t kAhead = 10;
  for (std::uint32_t e = 0; e < count; ++e) {
    if (e + kAhead < count) {
      hwy::Prefetch(records + std::size_t{record::kSize} * entries[e + kAhead].gaussian);
    }
    HWY_ALIGN float r[record::kSize];
    axes.ToTile(records + std::size_t{record::kSize} * entries[e].gaussian, r);
    FloatVec sums[16];
    for (FloatVec& sum : sums) sum = hn::Zero(d);
    const FloatVec k = hn::Set(d, r[record::kK]);
    const FloatVec depth_scale = hn::Set(d, r[record::kDepth]);
    const FloatVec depth_factor =
        hn::Set(d, r[record::kDepth] / (static_cast<float>(kLn2) * r[record::kKappa]));
    std::uint64_t todo = entries[e].blocks;
    do {
      int block[kBackwardJam];
      FloatVec s[kBackwardJam], t[kBackwardJam], p[kBackwardJam], q[kBackwardJam], z[kBackwardJam];
      FloatVec zz[kBackwardJam], n[kBackwardJam], u[kBackwardJam], reciprocal[kBackwardJam];
      FloatVec alpha[kBackwardJam], open[kBackwardJam], transmittance[kBackwardJam];
      FloatMask hit[kBackwardJam], free[kBackwardJam];
      GSUT_UNROLL for (int i = 0; i < kBackwardJam; ++i) {
        block[i] = todo != 0 ? __builtin_ctzll(todo) : kBlocks;
        todo &= todo - 1;
        s[i] = hn::Load(d, field(block[i], kFieldS));
        t[i] = hn::Load(d, field(block[i], kFieldT));
        transmittance[i] = hn::Load(d, field(block[i], kFieldTransmittance));
      }
      // The same operations in the same order as the forward pass: the same bits, the same hits.
      GSUT_UNROLL for (int i = 0; i < kBackwardJam; ++i) {
        p[i] = hn::MulAdd(hn::Set(d, r[1]), s[i],
                          hn::MulAdd(hn::Set(d, r[2]), t[i], hn::Set(d, r[0])));
        q[i] = hn::MulAdd(hn::Set(d, r[4]), s[i],
                          hn::MulAdd(hn::Set(d, r[5]), t[i], hn::Set(d, r[3])));
        z[i] = hn::MulAdd(hn::Set(d, r[7]), s[i],
                          hn::MulAdd(hn::Set(d, r[8]), t[i], hn::Set(d, r[6])));
        z[i] = hn::Max(z[i], hn::Zero(d));
        n[i] = hn::MulAdd(p[i], p[i], hn::Mul(q[i], q[i]));
        zz[i] = hn::Mul(z[i], z[i]);
        hit[i] = hn::And(hn::Ge(transmittance[i], stop), hn::Lt(n[i], zz[i]));
        zz[i] = hn::MulAdd(k, n[i], zz[i]);
      }
      GSUT_UNROLL for (int i = 0; i < kBackwardJam; ++i) reciprocal[i] = FastReciprocal(zz[i]);
      GSUT_UNROLL for (int i = 0; i < kBackwardJam; ++i) {
        u[i] = hn::Mul(n[i], reciprocal[i]);
        alpha[i] = FastExp2(hn::MulAdd(hn::Set(d, r[record::kKappa]), u[i],
                                       hn::Set(d, r[record::kLog2Opacity])));
        free[i] = hn::And(hit[i], hn::Lt(alpha[i], alpha_limit));
        alpha[i] = hn::IfThenElseZero(hit[i], hn::Min(alpha[i], alpha_limit));
      }
      GSUT_UNROLL for (int i = 0; i < kBackwardJam; ++i) {
        open[i] = FastReciprocal(hn::Sub(one, alpha[i]));
      }
      GSUT_UNROLL for (int i = 0; i < kBackwardJam; ++i) {
        FloatVec weight = hn::Mul(alpha[i], transmittance[i]);
        if (kStopBefore) {
          const FloatMask ends =
              hn::And(hit[i], hn::Le(hn::Sub(transmittance[i], weight), stop));
          weight = hn::IfThenZeroElse(ends, weight);
          free[i] = hn::AndNot(ends, free[i]);
          hit[i] = hn::AndNot(ends, hit[i]);
          hn::Store(hn::IfThenElse(ends, hn::Neg(transmittance[i]),
                                   hn::Sub(transmittance[i], weight)),
                    d, field(block[i], kFieldTransmittance));
        } else {
          hn::Store(hn::Sub(transmittance[i], weight), d, field(block[i], kFieldTransmittance));
        }
        const FloatVec red = hn::Load(d, field(block[i], kFieldRed));
        const FloatVec green = hn::Load(d, field(block[i], kFieldGreen));
        const FloatVec blue = hn::Load(d, field(block[i], kFieldBlue));
        sums[slot::kColor] = hn::MulAdd(weight, red, sums[slot::kColor]);
        sums[slot::kColor + 1] = hn::MulAdd(weight, green, sums[slot::kColor + 1]);
        sums[slot::kColor + 2] = hn::MulAdd(weight, blue, sums[slot::kColor + 2]);
        FloatVec value = hn::MulAdd(
            hn::Set(d, r[record::kColor]), red,
            hn::MulAdd(hn::Set(d, r[record::kColor + 1]), green,
                       hn::Mul(hn::Set(d, r[record::kColor + 2]), blue)));
        FloatVec to_depth = hn::Zero(d);  // weight x dL/ddepth
        FloatVec unit_depth = hn::Zero(d);
        if (kDepth) {
          const FloatVec along = hn::Load(d, field(block[i], kFieldAlong));
          unit_depth = hn::IfThenElseZero(hit[i], hn::Mul(z[i], reciprocal[i]));
          value = hn::MulAdd(hn::Mul(depth_scale, unit_depth), along, value);
          to_depth = hn::Mul(weight, along);
        }
        const FloatVec behind =
            hn::NegMulAdd(weight, value, hn::Load(d, field(block[i], kFieldBehind)));
        hn::Store(behind, d, field(block[i], kFieldBehind));
        // h = alpha dL/dalpha, 0 where alpha is clamped or the pixel is not hit.
        const FloatVec h = hn::IfThenElseZero(
            free[i], hn::Mul(alpha[i], hn::NegMulAdd(behind, open[i],
                                                     hn::Mul(transmittance[i], value))));
        // A miss may hold infinities: they are taken out before they meet a 0.
        const FloatVec safe_u = hn::IfThenElseZero(hit[i], u[i]);
        const FloatVec safe_reciprocal = hn::IfThenElseZero(hit[i], reciprocal[i]);
        const FloatVec hr = hn::Mul(h, safe_reciprocal);
        const FloatVec hru = hn::Mul(hr, safe_u);
        FloatVec to_form = hn::NegMulAdd(k, hru, hr);
        FloatVec to_z = hn::Mul(hru, z[i]);
        if (kDepth) {
          const FloatVec scaled = hn::Mul(to_depth, depth_factor);
          const FloatVec second = hn::Mul(scaled, hn::Mul(unit_depth, safe_reciprocal));
          to_form = hn::NegMulAdd(k, second, to_form);
          to_z = hn::MulAdd(second, z[i], to_z);
          to_z = hn::NegMulAdd(hn::Mul(hn::Set(d, 0.5f), scaled), safe_reciprocal, to_z);
          sums[slot::kDepth] = hn::MulAdd(to_depth, unit_depth, sums[slot::kDepth]);
        }
        sums[slot::kHu] = hn::MulAdd(h, safe_u, sums[slot::kHu]);
        sums[slot::kH] = hn::Add(sums[slot::kH], h);
        const FloatVec gp = hn::Mul(to_form, p[i]);
        const FloatVec gq = hn::Mul(to_form, q[i]);
        sums[0] = hn::Add(sums[0], gp);
        sums[1] = hn::MulAdd(gp, s[i], sums[1]);
        sums[2] = hn::MulAdd(gp, t[i], sums[2]);
        sums[3] = hn::Add(sums[3], gq);
        sums[4] = hn::MulAdd(gq, s[i], sums[4]);
        sums[5] = hn::MulAdd(gq, t[i], sums[5]);
        sums[6] = hn::Add(sums[6], to_z);
        sums[7] = hn::MulAdd(to_z, s[i], sums[7]);
        sums[8] = hn::MulAdd(to_z, t[i], sums[8]);
      }
    } while (todo != 0);
    HWY_ALIGN float totals[16];
    SumLanes16(sums, totals);
    axes.FromTile(totals, &frame->slot_gradients[std::size_t{16} * entries[e].slot]);
    frame->slot_touched[entries[e].slot] = 1;
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
