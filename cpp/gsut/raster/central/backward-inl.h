// The backward pass of one tile: gradients of each pair's linear forms, opacity and colour.

#if defined(GSUT_RASTER_CENTRAL_BACKWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CENTRAL_BACKWARD_INL_H_
#undef GSUT_RASTER_CENTRAL_BACKWARD_INL_H_
#else
#define GSUT_RASTER_CENTRAL_BACKWARD_INL_H_
#endif

#include "gsut/raster/central/tile_axes-inl.h"
#include "gsut/raster/pixels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// State of a tile's pixels, block by block: fields of kLanes floats.
enum PixelField {
  kFieldS,
  kFieldT,
  kFieldRed,  // dL/dred ...
  kFieldGreen,
  kFieldBlue,
  kFieldTransmittance,
  kFieldBehind,  // what lies behind the Gaussians blended so far, as L sees it
  kFieldAlong,   // dL/ddepth times the ray's length
  kFieldSquare,  // dL/ddistortion times the ray's length squared
  kFieldMean,    // of the distances, which the distortion is about
  kFieldError,   // see ImageGradients::error
  // Of the Gaussian at hand:
  kFieldP,
  kFieldQ,
  kFieldZ,
  kFieldReciprocal,  // 1 / (z^2 + k N), 0 where there is no hit
  kFieldU,
  kFieldAlpha,  // 0 where there is no hit, negative where it is clamped
  // Gradients to the ray, with rays only:
  kFieldToS,
  kFieldToT,
  kNumFields
};

// to_rays: 2 x 256 gradients to s and t of the tile's pixels, swizzled; with with_rays.
// NOLINTNEXTLINE(readability-function-size): one loop whose state is in registers.
HWY_INLINE void BackwardTile(bool with_depth, bool stop_before, bool with_rays, bool with_error,
                             const TileGrid& grid, int tile, float alpha_max,
                             float transmittance_min, const PixelGradients& gradients, Frame* frame,
                             float* to_rays) {
  const FloatTag d;
  const std::uint32_t count = frame->entry_count[tile];
  if (with_rays) __builtin_memset(to_rays, 0, sizeof(float) * 2 * kTilePixels);
  if (count == 0) return;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  const TileAxes to_tile = ToTileAxes(grid, tile);
  const float* center = &grid.center[static_cast<std::size_t>(tile) * kDirectionSize];
  const TileAxes from_tile = FromTileAxes(grid, tile);
  HWY_ALIGN float state[kBlocks * kNumFields * kLanes];
  const auto field = [&](int block, int f)
                         HWY_ATTR { return state + (block * kNumFields + f) * kLanes; };
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
    if (with_depth) {
      const FloatVec g = hn::Load(d, gradients.depth + b * kLanes);
      hn::Store(g, d, field(b, kFieldAlong));
      behind = hn::MulAdd(g, hn::Load(d, &frame->depth[o]), behind);
      const FloatVec square = hn::Load(d, gradients.distortion + b * kLanes);
      const DepthOfBlock depth(grid, *frame, o);
      hn::Store(square, d, field(b, kFieldSquare));
      hn::Store(depth.mean, d, field(b, kFieldMean));
      behind = hn::MulAdd(square, depth.distortion, behind);
    }
    if (with_error) {
      hn::Store(hn::Load(d, gradients.error + b * kLanes), d, field(b, kFieldError));
    }
    hn::Store(hn::Load(d, &grid.start[o]), d, field(b, kFieldTransmittance));
    hn::Store(behind, d, field(b, kFieldBehind));
    if (with_rays) {
      hn::Store(hn::Zero(d), d, field(b, kFieldToS));
      hn::Store(hn::Zero(d), d, field(b, kFieldToT));
    }
  }

  const FloatVec alpha_limit = hn::Set(d, alpha_max);
  const FloatVec stop = hn::Set(d, transmittance_min);
  const FloatVec one = hn::Set(d, 1.0f);
  const TileEntry* entries = &frame->entries[frame->tile_begin[tile]];
  const float* records = frame->records.data();
  constexpr double kLn2 = 0.69314718055994530942;
  constexpr std::uint32_t kAhead = 8;
  for (std::uint32_t e = 0; e < count; ++e) {
    if (e + kAhead < count) {
      const TileEntry& next = entries[e + kAhead];
      hwy::Prefetch(records + std::size_t{record::kSize} * next.gaussian);
      FetchDirection(*frame, entries[e + kAhead / 2].gaussian);
      // Slots lie in the order of the Gaussians: without this, each store waits for its line and
      // those behind it wait too.
      __builtin_prefetch(&frame->slot_gradients[std::size_t{16} * next.slot], 1);
      __builtin_prefetch(&frame->slot_touched[next.slot], 1);
    }
    HWY_ALIGN float r[record::kSize];
    TurnRecord(to_tile, center, *frame, entries[e].gaussian, r);
    FloatVec sums[16];
    GSUT_UNROLL for (int i = 0; i < 16; ++i) sums[i] = hn::Zero(d);
    const FloatVec k = hn::Set(d, r[record::kK]);
    const FloatVec kappa = hn::Set(d, r[record::kKappa]);
    const FloatVec log2_opacity = hn::Set(d, r[record::kLog2Opacity]);
    const FloatVec depth_scale = hn::Set(d, r[record::kDepth]);
    const FloatVec depth_factor =
        hn::Set(d, r[record::kDepth] / (static_cast<float>(kLn2) * r[record::kKappa]));
    // First all alphas, then the blend: the first is wide and without order, the second needs the
    // registers for its sums. In one loop both take a fifth longer.
    for (std::uint64_t todo = entries[e].blocks; todo != 0; todo &= todo - 1) {
      float* at = field(__builtin_ctzll(todo), 0);
      const FloatVec s = hn::Load(d, at + kFieldS * kLanes);
      const FloatVec t = hn::Load(d, at + kFieldT * kLanes);
      // The same operations in the same order as the forward pass: the same bits, the same hits.
      const FloatVec p =
          hn::MulAdd(hn::Set(d, r[1]), s, hn::MulAdd(hn::Set(d, r[2]), t, hn::Set(d, r[0])));
      const FloatVec q =
          hn::MulAdd(hn::Set(d, r[4]), s, hn::MulAdd(hn::Set(d, r[5]), t, hn::Set(d, r[3])));
      const FloatVec z = hn::Max(
          hn::MulAdd(hn::Set(d, r[7]), s, hn::MulAdd(hn::Set(d, r[8]), t, hn::Set(d, r[6]))),
          hn::Zero(d));
      const FloatVec n = hn::MulAdd(p, p, hn::Mul(q, q));
      const FloatVec zz = hn::Mul(z, z);
      const FloatMask hit = hn::Lt(n, zz);
      // A miss may hold infinities: they are taken out here.
      const FloatVec reciprocal = hn::IfThenElseZero(hit, FastReciprocal(hn::MulAdd(k, n, zz)));
      const FloatVec u = hn::Mul(n, reciprocal);
      const FloatVec alpha = FastExp2(hn::MulAdd(kappa, u, log2_opacity));
      const FloatVec signed_alpha =
          hn::IfThenElse(hn::Lt(alpha, alpha_limit), alpha, hn::Neg(alpha_limit));
      hn::Store(p, d, at + kFieldP * kLanes);
      hn::Store(q, d, at + kFieldQ * kLanes);
      hn::Store(z, d, at + kFieldZ * kLanes);
      hn::Store(reciprocal, d, at + kFieldReciprocal * kLanes);
      hn::Store(u, d, at + kFieldU * kLanes);
      hn::Store(hn::IfThenElseZero(hit, signed_alpha), d, at + kFieldAlpha * kLanes);
    }
    for (std::uint64_t todo = entries[e].blocks; todo != 0; todo &= todo - 1) {
      float* at = field(__builtin_ctzll(todo), 0);
      const auto get = [&](int f) HWY_ATTR { return hn::Load(d, at + f * kLanes); };
      const FloatVec transmittance = get(kFieldTransmittance);
      const FloatMask open = hn::Ge(transmittance, stop);
      FloatVec signed_alpha = hn::IfThenElseZero(open, get(kFieldAlpha));
      FloatVec alpha = hn::Abs(signed_alpha);
      FloatVec weight = hn::Mul(alpha, transmittance);
      if (stop_before) {
        const FloatMask ends =
            hn::And(hn::Gt(alpha, hn::Zero(d)), hn::Le(hn::Sub(transmittance, weight), stop));
        weight = hn::IfThenZeroElse(ends, weight);
        signed_alpha = hn::IfThenZeroElse(ends, signed_alpha);
        alpha = hn::IfThenZeroElse(ends, alpha);
        hn::Store(hn::IfThenElse(ends, hn::Neg(transmittance), hn::Sub(transmittance, weight)), d,
                  at + kFieldTransmittance * kLanes);
      } else {
        hn::Store(hn::Sub(transmittance, weight), d, at + kFieldTransmittance * kLanes);
      }
      const FloatVec past = FastReciprocal(hn::Sub(one, alpha));
      const FloatVec red = get(kFieldRed), green = get(kFieldGreen), blue = get(kFieldBlue);
      sums[slot::kColor] = hn::MulAdd(weight, red, sums[slot::kColor]);
      sums[slot::kColor + 1] = hn::MulAdd(weight, green, sums[slot::kColor + 1]);
      sums[slot::kColor + 2] = hn::MulAdd(weight, blue, sums[slot::kColor + 2]);
      if (with_error) {
        sums[slot::kError] = hn::MulAdd(weight, get(kFieldError), sums[slot::kError]);
      }
      FloatVec value = hn::MulAdd(hn::Set(d, r[record::kColor]), red,
                                  hn::MulAdd(hn::Set(d, r[record::kColor + 1]), green,
                                             hn::Mul(hn::Set(d, r[record::kColor + 2]), blue)));
      const FloatVec reciprocal = get(kFieldReciprocal);
      const FloatVec z = get(kFieldZ);
      FloatVec to_depth = hn::Zero(d);  // weight x dL/ddepth
      FloatVec unit_depth = hn::Zero(d);
      if (with_depth) {
        const FloatVec along = get(kFieldAlong);
        unit_depth = hn::Mul(z, reciprocal);
        const FloatVec distance = hn::Mul(depth_scale, unit_depth);
        const FloatVec apart = hn::Sub(distance, get(kFieldMean));
        const FloatVec pull = hn::Mul(get(kFieldSquare), apart);
        value = hn::MulAdd(distance, along, hn::MulAdd(pull, apart, value));
        to_depth = hn::Mul(weight, hn::Add(along, hn::Add(pull, pull)));
      }
      const FloatVec here = hn::Mul(weight, value);
      const FloatVec behind = hn::Sub(get(kFieldBehind), here);
      hn::Store(behind, d, at + kFieldBehind * kLanes);
      // h = alpha dL/dalpha, 0 where alpha is clamped or the pixel is not hit.
      const FloatVec h = hn::IfNegativeThenElse(signed_alpha, hn::Zero(d),
                                                hn::NegMulAdd(hn::Mul(alpha, past), behind, here));
      const FloatVec u = get(kFieldU);
      const FloatVec hr = hn::Mul(h, reciprocal);
      const FloatVec hru = hn::Mul(hr, u);
      FloatVec to_form = hn::NegMulAdd(k, hru, hr);
      FloatVec to_z = hn::Mul(hru, z);
      if (with_depth) {
        const FloatVec scaled = hn::Mul(to_depth, depth_factor);
        const FloatVec second = hn::Mul(scaled, hn::Mul(unit_depth, reciprocal));
        to_form = hn::NegMulAdd(k, second, to_form);
        to_z = hn::MulAdd(second, z, to_z);
        to_z = hn::NegMulAdd(hn::Mul(hn::Set(d, 0.5f), scaled), reciprocal, to_z);
        sums[slot::kDepth] = hn::MulAdd(to_depth, unit_depth, sums[slot::kDepth]);
      }
      sums[slot::kHu] = hn::MulAdd(h, u, sums[slot::kHu]);
      sums[slot::kH] = hn::Add(sums[slot::kH], h);
      const FloatVec s = get(kFieldS), t = get(kFieldT);
      const FloatVec gp = hn::Mul(to_form, get(kFieldP));
      const FloatVec gq = hn::Mul(to_form, get(kFieldQ));
      sums[0] = hn::Add(sums[0], gp);
      sums[1] = hn::MulAdd(gp, s, sums[1]);
      sums[2] = hn::MulAdd(gp, t, sums[2]);
      sums[3] = hn::Add(sums[3], gq);
      sums[4] = hn::MulAdd(gq, s, sums[4]);
      sums[5] = hn::MulAdd(gq, t, sums[5]);
      sums[6] = hn::Add(sums[6], to_z);
      sums[7] = hn::MulAdd(to_z, s, sums[7]);
      sums[8] = hn::MulAdd(to_z, t, sums[8]);
      if (with_rays) {
        const FloatVec scale = hn::Mul(hn::Set(d, static_cast<float>(2.0 * kLn2)), kappa);
        const auto to_ray = [&](int field_at, int j) HWY_ATTR {
          const FloatVec sum =
              hn::NegMulAdd(to_z, hn::Set(d, r[record::kC + j]),
                            hn::MulAdd(gp, hn::Set(d, r[record::kA + j]),
                                       hn::Mul(gq, hn::Set(d, r[record::kB + j]))));
          hn::Store(hn::MulAdd(scale, sum, get(field_at)), d, at + field_at * kLanes);
        };
        to_ray(kFieldToS, 1);
        to_ray(kFieldToT, 2);
      }
    }
    HWY_ALIGN float totals[16];
    SumLanes16(sums, totals);
    from_tile.Turn(totals, &frame->slot_gradients[std::size_t{16} * entries[e].slot]);
    frame->slot_touched[entries[e].slot] = 1;
  }
  if (with_rays) {
    for (int b = 0; b < kBlocks; ++b) {
      hn::Store(hn::Load(d, field(b, kFieldToS)), d, to_rays + b * kLanes);
      hn::Store(hn::Load(d, field(b, kFieldToT)), d, to_rays + kTilePixels + b * kLanes);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
