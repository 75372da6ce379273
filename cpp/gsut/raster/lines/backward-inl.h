// The backward pass of one tile of lines: sums over each pair's pixels, and gradients to the lines.
//
// blend_backward-inl.h gives h = raw dL/draw and dL/dx for each pixel. With r the residual over
// k and u = |r|^2 (pair-inl.h), raw = strength exp(-k^2 u / 2) gives -k^2 h r as gradient to r.
// r = M (mean - nearest point) / k, and moving along the line changes no |r|, so that
//   dL/d(M mean) = -k q,  q = h r + g w,  w = (w_x, w_y, 1),
//   g = -sd / k dL/dx / (1 + w_x^2 + w_y^2),
// the second term as x = m.D + sd (e.w) / (1 + |w|^2) follows e along w. The gradient to M itself
// comes times M^T, as a product with M (mean - nearest point): -k^2 K, K the symmetric
//   K = sum of q r^T + g r w^T,  V = sum of q,
// both in the turned whitened frame of the tile. They are turned into the Gaussian's own whitened
// frame, where gradients of its parameters follow from them alone (gradients-inl.h).

#if defined(GSUT_RASTER_LINES_BACKWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_BACKWARD_INL_H_
#undef GSUT_RASTER_LINES_BACKWARD_INL_H_
#else
#define GSUT_RASTER_LINES_BACKWARD_INL_H_
#endif

#include "gsut/raster/channels_backward-inl.h"
#include "gsut/raster/lines/flat_backward-inl.h"
#include "gsut/raster/lines/forward-inl.h"
#include "gsut/raster/lines/line_fields-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Pairs that are taken through the backward pass together.
inline constexpr int kBackwardPairs = 16;

// Turns V and K of `count` pairs into the Gaussians' own frames: V <- Q^T V, K <- Q^T K Q with the
// rows q1, q2 and q1 x q2 of Q, a pair a lane.
HWY_INLINE void TurnIntoOwnFrames(const LineChunk& chunk, float (*sums)[kBackwardPairs],
                                  int count) {
  using line_slot::kK;
  using line_slot::kV;
  const FloatTag d;
  for (int begin = 0; begin < count; begin += kLanes) {
    const auto sum = [&](int k) HWY_ATTR { return Lane(hn::Load(d, sums[k] + begin)); };
    const auto store = [&](int k, Lane value) HWY_ATTR { hn::Store(value.v, d, sums[k] + begin); };
    Lane q[3][3];
    for (int k = 0; k < 3; ++k) {
      q[0][k] = Lane(hn::Load(d, chunk.values[LineChunk::kQ1 + k] + begin));
      q[1][k] = Lane(hn::Load(d, chunk.values[LineChunk::kQ2 + k] + begin));
    }
    q[2][0] = q[0][1] * q[1][2] - q[0][2] * q[1][1];
    q[2][1] = q[0][2] * q[1][0] - q[0][0] * q[1][2];
    q[2][2] = q[0][0] * q[1][1] - q[0][1] * q[1][0];
    const Lane v[3] = {sum(kV), sum(kV + 1), sum(kV + 2)};
    const Lane k[3][3] = {{sum(kK), sum(kK + 1), sum(kK + 2)},
                          {sum(kK + 1), sum(kK + 3), sum(kK + 4)},
                          {sum(kK + 2), sum(kK + 4), sum(kK + 5)}};
    Lane half[3][3];  // K Q
    for (int i = 0; i < 3; ++i) {
      store(kV + i, q[0][i] * v[0] + q[1][i] * v[1] + q[2][i] * v[2]);
      for (int j = 0; j < 3; ++j) {
        half[j][i] = k[j][0] * q[0][i] + k[j][1] * q[1][i] + k[j][2] * q[2][i];
      }
    }
    int at = kK;
    for (int i = 0; i < 3; ++i) {
      for (int j = i; j < 3; ++j) {
        store(at++, q[0][i] * half[0][j] + q[1][i] * half[1][j] + q[2][i] * half[2][j]);
      }
    }
  }
}

// Leaves all sums of `count` pairs in their slots.
HWY_INLINE void StoreSlots(const float (*sums)[kBackwardPairs], const TileEntry* entries, int count,
                           Frame* frame) {
  for (int i = 0; i < count; ++i) {
    float* row = &frame->slot_gradients[std::size_t{16} * entries[i].slot];
    for (int k = 0; k < 16; ++k) row[k] = sums[k][i];
    frame->slot_touched[entries[i].slot] = 1;
  }
}

// One pair at one block of pixels, as vectors: what its residual gets and passes on.
struct ResidualGradient {
  FloatVec r[3], w[2];  // 0 where there is no hit
  FloatVec q[3];
  FloatVec g;
  FloatVec x;            // 0 where there is no hit
  FloatVec to_distance;  // dL/dx
};

// Phase 1: evaluates the response again, walks the blend on, and forms the residual's gradient.
HWY_INLINE ResidualGradient BackwardResidual(BackwardFlags flags, const BlendLimits& limits,
                                             const LineChunk& chunk, int j, BlockFields fields,
                                             FloatVec* sums, float* pair) {
  using C = LineChunk;
  const FloatTag d;
  const LinePixels line = LinesOf(fields);
  const LineHit hit = HitOf(chunk, j, line);
  const FloatMask is_hit = IsHit(hit, line);
  // A miss may be anywhere: its weight 0 must not meet infinity.
  const auto of_hit = [&](FloatVec v) HWY_ATTR { return hn::IfThenElseZero(is_hit, v); };
  const FloatVec exponent =
      hn::MulAdd(chunk.Get(C::kKappa, j), hit.u, chunk.Get(C::kLog2Strength, j));
  const auto [h, to_distance] = PassBlend(flags, limits, chunk, j, is_hit, exponent,
                                          of_hit(hn::Sub(hit.x, line.slide)), fields, sums, pair);
  ResidualGradient out;
  out.x = of_hit(hit.x);
  out.to_distance = to_distance;
  out.r[0] = of_hit(hn::Mul(hit.reciprocal, hn::MulAdd(hit.c, hit.w_y, hit.e_x)));
  out.r[1] = of_hit(hn::Mul(hit.reciprocal, hn::NegMulAdd(hit.c, hit.w_x, hit.e_y)));
  out.r[2] = of_hit(hn::Neg(hit.tau));
  out.w[0] = of_hit(hit.w_x);
  out.w[1] = of_hit(hit.w_y);
  GSUT_UNROLL for (int i = 0; i < 3; ++i) out.q[i] = hn::Mul(h, out.r[i]);
  out.g = hn::Zero(d);
  if (flags.with_depth) {
    // -sd / k = -reach / cut-off, and the cut-off is kappa over -log2(e) / 2.
    constexpr float kHalfLog2E = 0.72134752044448170368f;
    const float scale = kHalfLog2E * chunk.values[C::kReach][j] / chunk.values[C::kKappa][j];
    out.g = hn::Mul(hn::Mul(hn::Set(d, scale), to_distance), of_hit(hit.reciprocal));
    out.q[0] = hn::MulAdd(out.g, out.w[0], out.q[0]);
    out.q[1] = hn::MulAdd(out.g, out.w[1], out.q[1]);
    out.q[2] = hn::Add(out.g, out.q[2]);
  }
  return out;
}

// Phase 2: adds to V and K.
HWY_INLINE void AddToSums(BackwardFlags flags, const ResidualGradient& of, FloatVec* sums) {
  FloatVec* v = sums + line_slot::kV;
  FloatVec* k = sums + line_slot::kK;
  const FloatVec *q = of.q, *r = of.r, *w = of.w;
  if (flags.with_depth) {
    const FloatVec g_x = hn::Mul(of.g, r[0]);
    const FloatVec g_y = hn::Mul(of.g, r[1]);
    const FloatVec g_z = hn::Mul(of.g, r[2]);
    k[0] = hn::MulAdd(g_x, w[0], k[0]);
    k[1] = hn::MulAdd(g_x, w[1], k[1]);
    k[2] = hn::Add(g_x, k[2]);
    k[3] = hn::MulAdd(g_y, w[1], k[3]);
    k[4] = hn::Add(g_y, k[4]);
    k[5] = hn::Add(g_z, k[5]);
  }
  GSUT_UNROLL for (int i = 0; i < 3; ++i) v[i] = hn::Add(v[i], q[i]);
  k[0] = hn::MulAdd(q[0], r[0], k[0]);
  k[1] = hn::MulAdd(q[0], r[1], k[1]);
  k[2] = hn::MulAdd(q[0], r[2], k[2]);
  k[3] = hn::MulAdd(q[1], r[1], k[3]);
  k[4] = hn::MulAdd(q[1], r[2], k[4]);
  k[5] = hn::MulAdd(q[2], r[2], k[5]);
}

// Phase 3, with rays: adds to the gradients to a, b, s, t and slide of the block's lines. To M
// times the line's origin and direction these are -k q, and k (x q - g reach r); both over k here.
// They reach a and s by column x, as M E1 = (x_a, y_a, 0), and so on: d/da = cut-off (x_a q_x + y_a
// q_y).
HWY_INLINE void AddToLines(BackwardFlags flags, const LineChunk& chunk, int j,
                           const ResidualGradient& of, BlockFields fields) {
  using C = LineChunk;
  const FloatTag d;
  FloatVec turn_x = hn::Mul(of.x, of.q[0]), turn_y = hn::Mul(of.x, of.q[1]);
  if (flags.with_depth) {
    const FloatVec reach = hn::Mul(chunk.Get(C::kReach, j), of.g);
    turn_x = hn::NegMulAdd(reach, of.r[0], turn_x);
    turn_y = hn::NegMulAdd(reach, of.r[1], turn_y);
    fields.Set(kLineToSlide, hn::Sub(fields.Get(kLineToSlide), of.to_distance));
  }
  constexpr float kTwoLn2 = 1.38629436111989061883f;
  const float cutoff = -kTwoLn2 * chunk.values[C::kKappa][j];
  const auto scaled = [&](int column)
                          HWY_ATTR { return hn::Set(d, cutoff * chunk.values[column][j]); };
  const FloatVec x_a = scaled(C::kXa), x_b = scaled(C::kXb);
  const FloatVec y_a = scaled(C::kYa), y_b = scaled(C::kYb);
  const auto add = [&](int field, FloatVec by_x, FloatVec x, FloatVec by_y, FloatVec y) HWY_ATTR {
    fields.Set(field, hn::MulAdd(by_x, x, hn::MulAdd(by_y, y, fields.Get(field))));
  };
  add(kLineToA, x_a, of.q[0], y_a, of.q[1]);
  add(kLineToB, x_b, of.q[0], y_b, of.q[1]);
  add(kLineToS, x_a, turn_x, y_a, turn_y);
  add(kLineToT, x_b, turn_x, y_b, turn_y);
}

// All phases of a Gaussian at one block.
HWY_INLINE void BackwardSolid(BackwardFlags flags, const BlendLimits& limits,
                              const LineChunk& chunk, int j, BlockFields fields, FloatVec* sums,
                              float* pair) {
  const ResidualGradient of = BackwardResidual(flags, limits, chunk, j, fields, sums, pair);
  AddToSums(flags, of, sums);
  if (flags.with_rays) AddToLines(flags, chunk, j, of, fields);
}

// Fills the slots of a tile's pairs: KeptPairs, or RayPairs. to_lines: with flags.with_rays 5 x 256
// floats for the gradients to a, b, s, t and slide of the tile's lines, swizzled. channels: with
// flags.with_channels.
template <class Pairs>
HWY_INLINE void BackwardLines(BackwardFlags flags, const RasterTask& task, const LineGrid& grid,
                              int tile, Pairs pairs, const PixelGradients& gradients, Frame* frame,
                              float* to_lines, TileChannels* channels = nullptr) {
  const FloatTag d;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  TileFields<kNumLineFields> fields;
  for (int block = 0; block < kBlocks; ++block) {
    const BlockFields at = fields.Block(block);
    StartBlock(flags, grid.tiles, *frame, gradients, pixel0, block, at);
    const LinePixels line = LoadLines(grid, pixel0 + static_cast<std::size_t>(block) * kLanes);
    at.Set(kLineA, line.a);
    at.Set(kLineB, line.b);
    at.Set(kLineSlide, line.slide);
    for (int field = kLineToA; field < kNumLineFields; ++field) at.Set(field, hn::Zero(d));
  }
  pairs.Start(flags, &fields);
  const std::uint32_t count = pairs.count;
  const TileEntry* entries = pairs.entries;
  const float* bundle = grid.bundles[static_cast<std::size_t>(tile)].values;
  const BlendLimits limits(task);
  const bool is_flat = IsFlat(task.gaussians.primitive);
  LineChunk chunk;
  HWY_ALIGN float columns[16][kBackwardPairs];  // sums, a pair a column
  for (std::uint32_t first = 0; first < count; first += kBackwardPairs) {
    const int here = static_cast<int>(HWY_MIN(count - first, std::uint32_t{kBackwardPairs}));
    const auto ids = [&](int j) { return entries[first + static_cast<std::uint32_t>(j)].gaussian; };
    if (HWY_LIKELY(!is_flat)) {
      chunk.Fill<false>(task, frame->records.data(), bundle, here, ids);
    } else {
      chunk.Fill<true>(task, frame->records.data(), bundle, here, ids);
    }
    for (int j = 0; j < here; ++j) {
      const std::uint32_t e = first + static_cast<std::uint32_t>(j);
      if (channels != nullptr) channels->Prepare(e);
      FloatVec sums[16];
      GSUT_UNROLL for (int i = 0; i < 16; ++i) sums[i] = hn::Zero(d);
      for (std::uint64_t todo = entries[e].blocks; todo != 0; todo &= todo - 1) {
        const int block = __builtin_ctzll(todo);
        const BlockFields at = fields.Block(block);
        float* pair = channels != nullptr ? channels->NextPair() : nullptr;
        pairs.Restore(e, block, at);
        if (HWY_UNLIKELY(is_flat)) {
          BackwardFlat(flags, limits, chunk, j, at, sums, pair);
        } else {
          BackwardSolid(flags, limits, chunk, j, at, sums, pair);
        }
      }
      if (channels != nullptr) channels->Finish(e);
      HWY_ALIGN float totals[16];
      SumLanes<16>(sums, totals);
      for (int k = 0; k < 16; ++k) columns[k][j] = totals[k];
    }
    if (HWY_LIKELY(!is_flat)) TurnIntoOwnFrames(chunk, columns, here);
    StoreSlots(columns, entries + first, here, frame);
  }
  if (flags.with_rays) fields.Export(kLineToA, to_lines);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
