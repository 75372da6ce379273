// The backward pass of one tile of rays from one point: gradients of each pair's linear forms,
// opacity, colour and distance.
//
// blend_backward-inl.h gives h = raw dL/draw and dL/dx for each pixel. With R = 1 / (z^2 + k N)
// and u = N R (frame.h), raw = strength 2^(kappa u) and x = depth z R lead on to the forms:
//   du/dp = 2 p R (1 - k u),         du/dz = -2 u R z,
//   dx/dp = -2 depth k z R^2 p,      dx/dz = depth (R - 2 z^2 R^2),   q as p.
// dL/dp = ln 2 kappa h du/dp + dL/dx dx/dp, and so on. The factor 2 ln 2 kappa, and for z the sign,
// are the same at all pixels and left to gradients-inl.h; dL/dx is divided by it once a pair.
// As p = a.(1, s, t), the sums over pixels of (dL/dp, s dL/dp, t dL/dp) are dL/da, and a ray's own
// s and t get dL/dp a_s + dL/dq b_s + dL/dz c_s.

#if defined(GSUT_RASTER_CENTRAL_BACKWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CENTRAL_BACKWARD_INL_H_
#undef GSUT_RASTER_CENTRAL_BACKWARD_INL_H_
#else
#define GSUT_RASTER_CENTRAL_BACKWARD_INL_H_
#endif

#include "gsut/raster/blend_backward-inl.h"
#include "gsut/raster/central/response-inl.h"
#include "gsut/raster/central/tile_axes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Fields of a block's pixels beside PixelField.
enum RayField {
  // Of the Gaussian at hand:
  kFieldP = kNumPixelFields,
  kFieldQ,
  kFieldZ,
  kFieldReciprocal,  // R, 0 where there is no hit
  kFieldU,
  kFieldAlpha,  // clamped; 0 where there is no hit
  // Gradients to the ray, with rays only:
  kFieldToS,
  kFieldToT,
  kNumRayFields
};

// A record as vectors of equal lanes; r: its 16 floats in the tile's frame.
struct RecordVectors {
  static constexpr double kLn2 = 0.69314718055994530942;
  const float* r;
  FloatVec k, kappa, log2_strength, color[3];
  FloatVec depth;
  FloatVec depth_factor;  // depth / (ln 2 kappa): of dL/dx beside h
  FloatVec ray_scale;     // 2 ln 2 kappa

  HWY_INLINE explicit RecordVectors(const float* record) : r(record) {
    const FloatTag d;
    k = hn::Set(d, r[record::kK]);
    kappa = hn::Set(d, r[record::kKappa]);
    log2_strength = hn::Set(d, r[record::kLog2Strength]);
    GSUT_UNROLL for (int c = 0; c < 3; ++c) color[c] = hn::Set(d, r[record::kColor + c]);
    depth = hn::Set(d, r[record::kDepth]);
    depth_factor = hn::Set(d, r[record::kDepth] / (static_cast<float>(kLn2) * r[record::kKappa]));
    ray_scale = hn::Mul(hn::Set(d, static_cast<float>(2.0 * kLn2)), kappa);
  }
};

// Phase 1: evaluates the response again and leaves it in the block's fields.
HWY_INLINE void RespondAgain(const RecordVectors& g, FloatVec alpha_max, BlockFields fields) {
  const RayForms forms = FormsAlong(g.r, fields.Get(kFieldS), fields.Get(kFieldT));
  const FloatMask hit = forms.IsHit();
  // A miss may hold infinities: they are taken out here.
  const FloatVec reciprocal = hn::IfThenElseZero(hit, FastReciprocal(forms.Denominator(g.k)));
  const FloatVec u = hn::Mul(forms.n, reciprocal);
  fields.Set(kFieldP, forms.p);
  fields.Set(kFieldQ, forms.q);
  fields.Set(kFieldZ, forms.z);
  fields.Set(kFieldReciprocal, reciprocal);
  fields.Set(kFieldU, u);
  const FloatVec raw = FastExp2(hn::MulAdd(g.kappa, u, g.log2_strength));
  fields.Set(kFieldAlpha, hn::IfThenElseZero(hit, hn::Min(raw, alpha_max)));
}

// Adds (to_form, s to_form, t to_form), the gradient to a linear form of (1, s, t), to three sums.
HWY_INLINE void AddToForm(FloatVec to_form, FloatVec s, FloatVec t, FloatVec* sums) {
  sums[0] = hn::Add(sums[0], to_form);
  sums[1] = hn::MulAdd(to_form, s, sums[1]);
  sums[2] = hn::MulAdd(to_form, t, sums[2]);
}

// Phase 2: walks the blend on, and from alpha and distance back to the forms and the rays.
HWY_INLINE void BackwardRays(BackwardFlags flags, const BlendLimits& limits, const RecordVectors& g,
                             BlockFields fields, FloatVec* sums) {
  const FloatTag d;
  const FloatVec reciprocal = fields.Get(kFieldReciprocal);
  const FloatVec z = fields.Get(kFieldZ);
  const FloatVec unit_distance = flags.with_depth ? hn::Mul(z, reciprocal) : hn::Zero(d);
  const auto [h, to_distance] = StepOver(flags, limits, g.color, fields.Get(kFieldAlpha),
                                         hn::Mul(g.depth, unit_distance), fields, sums, nullptr);
  const FloatVec u = fields.Get(kFieldU);
  sums[slot::kH] = hn::Add(sums[slot::kH], h);
  const FloatVec hr = hn::Mul(h, reciprocal);
  const FloatVec hru = hn::Mul(hr, u);
  FloatVec to_pq = hn::NegMulAdd(g.k, hru, hr);  // times p is dL/dp, times q dL/dq
  FloatVec to_z = hn::Mul(hru, z);               // -dL/dz
  if (flags.with_depth) {
    const FloatVec scaled = hn::Mul(to_distance, g.depth_factor);
    const FloatVec second = hn::Mul(scaled, hn::Mul(unit_distance, reciprocal));
    to_pq = hn::NegMulAdd(g.k, second, to_pq);
    to_z = hn::MulAdd(second, z, to_z);
    to_z = hn::NegMulAdd(hn::Mul(hn::Set(d, 0.5f), scaled), reciprocal, to_z);
    sums[slot::kDepth] = hn::MulAdd(to_distance, unit_distance, sums[slot::kDepth]);
  }
  sums[slot::kHu] = hn::MulAdd(h, u, sums[slot::kHu]);
  const FloatVec s = fields.Get(kFieldS), t = fields.Get(kFieldT);
  const FloatVec to_p = hn::Mul(to_pq, fields.Get(kFieldP));
  const FloatVec to_q = hn::Mul(to_pq, fields.Get(kFieldQ));
  AddToForm(to_p, s, t, sums + record::kA);
  AddToForm(to_q, s, t, sums + record::kB);
  AddToForm(to_z, s, t, sums + record::kC);
  if (!flags.with_rays) return;
  GSUT_UNROLL for (int j = 0; j < 2; ++j) {  // s, t
    const auto slope = [&](int form) HWY_ATTR { return hn::Set(d, g.r[form + 1 + j]); };
    const FloatVec sum =
        hn::NegMulAdd(to_z, slope(record::kC),
                      hn::MulAdd(to_p, slope(record::kA), hn::Mul(to_q, slope(record::kB))));
    fields.Set(kFieldToS + j, hn::MulAdd(g.ray_scale, sum, fields.Get(kFieldToS + j)));
  }
}

// Fetches what a later pair needs: its record, and once that is here, its direction.
HWY_INLINE void FetchAhead(const Frame& frame, const TileEntry* entry, std::uint32_t left) {
  constexpr std::uint32_t kAhead = 8;
  if (left <= kAhead) return;
  const TileEntry& next = entry[kAhead];
  hwy::Prefetch(frame.records.data() + std::size_t{record::kSize} * next.gaussian);
  FetchDirection(frame, entry[kAhead / 2].gaussian);
  // Slots lie in the order of the Gaussians: without this, each store waits for its line and those
  // behind it wait too.
  __builtin_prefetch(&frame.slot_gradients[std::size_t{16} * next.slot], 1);
  __builtin_prefetch(&frame.slot_touched[next.slot], 1);
}

// Fills the slots of a tile's pairs. to_rays: with flags.with_rays 2 x 256 floats for the gradients
// to s and t of the tile's pixels, swizzled.
HWY_INLINE void BackwardTile(BackwardFlags flags, const RasterTask& task, const TileGrid& grid,
                             int tile, const PixelGradients& gradients, Frame* frame,
                             float* to_rays) {
  const FloatTag d;
  const TileEntry* entries = frame->entries.data() + frame->tile_begin[tile];
  const std::uint32_t count = frame->entry_count[tile];
  if (count == 0) {
    if (flags.with_rays) __builtin_memset(to_rays, 0, sizeof(float) * 2 * kTilePixels);
    return;
  }
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  TileFields<kNumRayFields> fields;
  for (int block = 0; block < kBlocks; ++block) {
    StartBlock(flags, grid, *frame, gradients, pixel0, block, fields.Block(block));
    if (!flags.with_rays) continue;
    fields.Block(block).Set(kFieldToS, hn::Zero(d));
    fields.Block(block).Set(kFieldToT, hn::Zero(d));
  }
  const TileAxes to_tile = ToTileAxes(grid, tile);
  const TileAxes from_tile = FromTileAxes(grid, tile);
  const float* center = &grid.center[static_cast<std::size_t>(tile) * kDirectionSize];
  const BlendLimits limits(task);
  for (std::uint32_t e = 0; e < count; ++e) {
    FetchAhead(*frame, entries + e, count - e);
    HWY_ALIGN float r[record::kSize];
    TurnRecord(to_tile, center, *frame, entries[e].gaussian, r);
    const RecordVectors g(r);
    FloatVec sums[16];
    GSUT_UNROLL for (int i = 0; i < 16; ++i) sums[i] = hn::Zero(d);
    // First all alphas, then the blend: the first is wide and without order, the second needs the
    // registers for its sums. In one loop both take a fifth longer.
    for (std::uint64_t todo = entries[e].blocks; todo != 0; todo &= todo - 1) {
      RespondAgain(g, limits.alpha_max, fields.Block(__builtin_ctzll(todo)));
    }
    for (std::uint64_t todo = entries[e].blocks; todo != 0; todo &= todo - 1) {
      BackwardRays(flags, limits, g, fields.Block(__builtin_ctzll(todo)), sums);
    }
    HWY_ALIGN float totals[16];
    SumLanes<16>(sums, totals);
    from_tile.Turn(totals, &frame->slot_gradients[std::size_t{16} * entries[e].slot]);
    frame->slot_touched[entries[e].slot] = 1;
  }
  if (flags.with_rays) fields.Export(kFieldToS, to_rays);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
