// The backward pass of one tile of lines: sums over each pair's pixels, and gradients to the lines.
//
// With r the residual over k, w = (w_x, w_y, 1), h = alpha dL/dalpha and, for the depth, g = -sd /
// k dL/dx / (1 + w_x^2 + w_y^2), all in the turned whitened frame: V = sum of q, q = h r + g w, and
// the symmetric K = sum of q r^T + g r w^T. They are turned into the Gaussian's own whitened frame;
// gradients of its parameters follow from them alone (line_gradients-inl.h).

#if defined(GSUT_RASTER_LINES_BACKWARD_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_BACKWARD_INL_H_
#undef GSUT_RASTER_LINES_BACKWARD_INL_H_
#else
#define GSUT_RASTER_LINES_BACKWARD_INL_H_
#endif

#include "gsut/raster/lines/forward-inl.h"
#include "gsut/raster/pixels-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// State of a tile's pixels, block by block: fields of kLanes floats.
enum LineField {
  kLineA,
  kLineB,
  kLineS,
  kLineT,
  kLineSlide,
  kLineRed,  // dL/dred ...
  kLineGreen,
  kLineBlue,
  kLineTransmittance,
  kLineBehind,  // what lies behind the Gaussians blended so far, as L sees it
  kLineAlong,   // dL/ddepth times the ray's length
  kLineSquare,  // dL/ddistortion times the ray's length squared
  kLineMean,    // of the distances, which the distortion is about
  kLineError,   // see ImageGradients::error
  // Gradients to the line, with poses only:
  kLineToA,
  kLineToB,
  kLineToS,
  kLineToT,
  kLineToSlide,
  kNumLineFields
};

// Sums of a pair.
enum LineSum { kSumV = 0, kSumK = 3, kSumH = 9, kSumColor = 10, kNumLineSums = 13 };
static_assert(slot::kError >= kNumLineSums);

// Turns V and K of up to 16 pairs into the Gaussians' own frames and leaves them in their slots.
HWY_INLINE void StoreSlots(const LineChunk& chunk, const float (*sums)[16],
                           const TileEntry* entries, int first, int count, Frame* frame) {
  const FloatTag d;
  for (int begin = 0; begin < count; begin += kLanes) {
    const auto sum = [&](int k) HWY_ATTR { return Lane(hn::Load(d, sums[k] + begin)); };
    Lane q[3][3];
    for (int k = 0; k < 3; ++k) {
      q[0][k] = Lane(hn::Load(d, chunk.values[LineChunk::kQ1 + k] + first + begin));
      q[1][k] = Lane(hn::Load(d, chunk.values[LineChunk::kQ2 + k] + first + begin));
    }
    q[2][0] = q[0][1] * q[1][2] - q[0][2] * q[1][1];
    q[2][1] = q[0][2] * q[1][0] - q[0][0] * q[1][2];
    q[2][2] = q[0][0] * q[1][1] - q[0][1] * q[1][0];
    const Lane k[3][3] = {{sum(kSumK), sum(kSumK + 1), sum(kSumK + 2)},
                          {sum(kSumK + 1), sum(kSumK + 3), sum(kSumK + 4)},
                          {sum(kSumK + 2), sum(kSumK + 4), sum(kSumK + 5)}};
    HWY_ALIGN float out[kNumLineSums][kLanes];
    const auto store = [&](int column, Lane value) HWY_ATTR { hn::Store(value.v, d, out[column]); };
    Lane half[3][3];  // K q, by columns of the result
    for (int i = 0; i < 3; ++i) {
      store(kSumV + i, q[0][i] * sum(kSumV) + q[1][i] * sum(kSumV + 1) + q[2][i] * sum(kSumV + 2));
      for (int j = 0; j < 3; ++j) {
        half[j][i] = k[j][0] * q[0][i] + k[j][1] * q[1][i] + k[j][2] * q[2][i];
      }
    }
    int column = kSumK;
    for (int i = 0; i < 3; ++i) {
      for (int j = i; j < 3; ++j) {
        store(column++, q[0][i] * half[0][j] + q[1][i] * half[1][j] + q[2][i] * half[2][j]);
      }
    }
    for (int c = kSumH; c < kNumLineSums; ++c) store(c, sum(c));
    for (int i = 0; i < HWY_MIN(kLanes, count - begin); ++i) {
      const std::uint32_t slot = entries[begin + i].slot;
      float* row = &frame->slot_gradients[std::size_t{16} * slot];
      for (int c = 0; c < kNumLineSums; ++c) row[c] = out[c][i];
      for (int c = kNumLineSums; c < 15; ++c) row[c] = 0.0f;
      row[slot::kError] = sums[slot::kError][begin + i];
      frame->slot_touched[slot] = 1;
    }
  }
}

// One pair at one block of pixels; adds to the sums and changes the block's state.
// NOLINTNEXTLINE(readability-function-size): one loop whose state is in registers.
HWY_INLINE void BackwardBlock(bool with_depth, bool stop_before, bool with_poses, bool with_error,
                              const LineChunk& chunk, int j, float alpha_max,
                              float transmittance_min, float* state, FloatVec* sums) {
  using C = LineChunk;
  const FloatTag d;
  const auto get = [&](int f) HWY_ATTR { return hn::Load(d, state + f * kLanes); };
  const auto put = [&](int f, FloatVec v) HWY_ATTR { hn::Store(v, d, state + f * kLanes); };
  const FloatVec one = hn::Set(d, 1.0f), zero = hn::Zero(d);
  const FloatVec stop = hn::Set(d, transmittance_min), limit = hn::Set(d, alpha_max);
  const FloatVec transmittance = get(kLineTransmittance);
  const LinePixels line = {get(kLineA), get(kLineB), get(kLineS), get(kLineT), get(kLineSlide)};
  // The same operations in the same order as the forward pass: the same bits, the same hits.
  const LineHit hit = HitOf(chunk, j, line);
  FloatMask is_hit = hn::And(hn::Ge(transmittance, stop), IsHit(hit, line));
  const FloatVec raw =
      FastExp2(hn::MulAdd(chunk.Get(C::kKappa, j), hit.u, chunk.Get(C::kLog2Opacity, j)));
  FloatVec alpha = hn::IfThenElseZero(is_hit, hn::Min(raw, limit));
  FloatVec weight = hn::Mul(alpha, transmittance);
  FloatVec left = hn::Sub(transmittance, weight);
  if (stop_before) {
    const FloatMask ends = hn::And(is_hit, hn::Le(left, stop));
    is_hit = hn::AndNot(ends, is_hit);
    left = hn::IfThenElse(ends, hn::Neg(transmittance), left);
    weight = hn::IfThenZeroElse(ends, weight);
    alpha = hn::IfThenZeroElse(ends, alpha);
  }
  put(kLineTransmittance, left);
  const FloatVec red = get(kLineRed), green = get(kLineGreen), blue = get(kLineBlue);
  sums[kSumColor] = hn::MulAdd(weight, red, sums[kSumColor]);
  sums[kSumColor + 1] = hn::MulAdd(weight, green, sums[kSumColor + 1]);
  sums[kSumColor + 2] = hn::MulAdd(weight, blue, sums[kSumColor + 2]);
  if (with_error) {
    sums[slot::kError] = hn::MulAdd(weight, get(kLineError), sums[slot::kError]);
  }
  FloatVec value =
      hn::MulAdd(chunk.Get(C::kRed, j), red,
                 hn::MulAdd(chunk.Get(C::kGreen, j), green, hn::Mul(chunk.Get(C::kBlue, j), blue)));
  FloatVec to_x = zero;  // dL/dx
  if (with_depth) {
    const FloatVec along = get(kLineAlong);
    // A miss may be anywhere: its weight 0 must not meet infinity.
    const FloatVec x = hn::IfThenElseZero(is_hit, hn::Sub(hit.x, line.slide));
    const FloatVec apart = hn::Sub(x, get(kLineMean));
    const FloatVec pull = hn::Mul(get(kLineSquare), apart);
    value = hn::MulAdd(x, along, hn::MulAdd(pull, apart, value));
    to_x = hn::Mul(weight, hn::Add(along, hn::Add(pull, pull)));
  }
  const FloatVec here = hn::Mul(weight, value);
  const FloatVec behind = hn::Sub(get(kLineBehind), here);
  put(kLineBehind, behind);
  // h = alpha dL/dalpha, 0 where alpha is clamped or the pixel is not hit.
  const FloatVec past = FastReciprocal(hn::Sub(one, alpha));
  const FloatVec h =
      hn::IfThenElseZero(hn::Lt(raw, limit), hn::NegMulAdd(hn::Mul(alpha, past), behind, here));
  const FloatVec r_x =
      hn::IfThenElseZero(is_hit, hn::Mul(hit.reciprocal, hn::MulAdd(hit.c, hit.w_y, hit.e_x)));
  const FloatVec r_y =
      hn::IfThenElseZero(is_hit, hn::Mul(hit.reciprocal, hn::NegMulAdd(hit.c, hit.w_x, hit.e_y)));
  const FloatVec r_z = hn::IfThenElseZero(is_hit, hn::Neg(hit.tau));
  FloatVec q_x = hn::Mul(h, r_x), q_y = hn::Mul(h, r_y), q_z = hn::Mul(h, r_z);
  FloatVec g = zero;
  if (with_depth) {
    // -sd / k = -reach / cut-off, and the cut-off is kappa over -log2(e) / 2.
    constexpr float kHalfLog2E = 0.72134752044448170368f;
    const float scale = kHalfLog2E * chunk.values[C::kReach][j] / chunk.values[C::kKappa][j];
    g = hn::Mul(hn::Mul(hn::Set(d, scale), to_x), hn::IfThenElseZero(is_hit, hit.reciprocal));
    const FloatVec w_x = hn::IfThenElseZero(is_hit, hit.w_x);
    const FloatVec w_y = hn::IfThenElseZero(is_hit, hit.w_y);
    q_x = hn::MulAdd(g, w_x, q_x);
    q_y = hn::MulAdd(g, w_y, q_y);
    q_z = hn::Add(g, q_z);
    const FloatVec g_x = hn::Mul(g, r_x), g_y = hn::Mul(g, r_y), g_z = hn::Mul(g, r_z);
    sums[kSumK] = hn::MulAdd(g_x, w_x, sums[kSumK]);
    sums[kSumK + 1] = hn::MulAdd(g_x, w_y, sums[kSumK + 1]);
    sums[kSumK + 2] = hn::Add(g_x, sums[kSumK + 2]);
    sums[kSumK + 3] = hn::MulAdd(g_y, w_y, sums[kSumK + 3]);
    sums[kSumK + 4] = hn::Add(g_y, sums[kSumK + 4]);
    sums[kSumK + 5] = hn::Add(g_z, sums[kSumK + 5]);
  }
  sums[kSumV] = hn::Add(sums[kSumV], q_x);
  sums[kSumV + 1] = hn::Add(sums[kSumV + 1], q_y);
  sums[kSumV + 2] = hn::Add(sums[kSumV + 2], q_z);
  sums[kSumK] = hn::MulAdd(q_x, r_x, sums[kSumK]);
  sums[kSumK + 1] = hn::MulAdd(q_x, r_y, sums[kSumK + 1]);
  sums[kSumK + 2] = hn::MulAdd(q_x, r_z, sums[kSumK + 2]);
  sums[kSumK + 3] = hn::MulAdd(q_y, r_y, sums[kSumK + 3]);
  sums[kSumK + 4] = hn::MulAdd(q_y, r_z, sums[kSumK + 4]);
  sums[kSumK + 5] = hn::MulAdd(q_z, r_z, sums[kSumK + 5]);
  sums[kSumH] = hn::Add(sums[kSumH], h);
  if (with_poses) {
    // To M times the line's origin and direction: -k q, and k (x q - g reach r); both over k here.
    const FloatVec x = hn::IfThenElseZero(is_hit, hit.x);
    FloatVec turn_x = hn::Mul(x, q_x), turn_y = hn::Mul(x, q_y);
    if (with_depth) {
      const FloatVec reach = hn::Mul(chunk.Get(C::kReach, j), g);
      turn_x = hn::NegMulAdd(reach, r_x, turn_x);
      turn_y = hn::NegMulAdd(reach, r_y, turn_y);
      put(kLineToSlide, hn::Sub(get(kLineToSlide), to_x));
    }
    // d/da = cut-off (x_a q_x + y_a q_y), and so on.
    constexpr float kTwoLn2 = 1.38629436111989061883f;
    const float cutoff = -kTwoLn2 * chunk.values[C::kKappa][j];
    const FloatVec x_a = hn::Set(d, cutoff * chunk.values[C::kXa][j]);
    const FloatVec x_b = hn::Set(d, cutoff * chunk.values[C::kXb][j]);
    const FloatVec y_a = hn::Set(d, cutoff * chunk.values[C::kYa][j]);
    const FloatVec y_b = hn::Set(d, cutoff * chunk.values[C::kYb][j]);
    put(kLineToA, hn::MulAdd(x_a, q_x, hn::MulAdd(y_a, q_y, get(kLineToA))));
    put(kLineToB, hn::MulAdd(x_b, q_x, hn::MulAdd(y_b, q_y, get(kLineToB))));
    put(kLineToS, hn::MulAdd(x_a, turn_x, hn::MulAdd(y_a, turn_y, get(kLineToS))));
    put(kLineToT, hn::MulAdd(x_b, turn_x, hn::MulAdd(y_b, turn_y, get(kLineToT))));
  }
}

// to_lines: 5 x 256 gradients to a, b, s, t and slide of the tile's lines, swizzled; with
// with_poses.
HWY_INLINE void BackwardLines(bool with_depth, bool stop_before, bool with_poses, bool with_error,
                              const RasterTask& task, const LineGrid& grid, int tile,
                              const PixelGradients& gradients, Frame* frame, float* to_lines) {
  const FloatTag d;
  const std::uint32_t count = frame->entry_count[tile];
  const TileGrid& tiles = grid.tiles;
  const std::size_t pixel0 = static_cast<std::size_t>(tile) * kTilePixels;
  HWY_ALIGN float state[kBlocks * kNumLineFields * kLanes];
  const auto field = [&](int block, int f)
                         HWY_ATTR { return state + (block * kNumLineFields + f) * kLanes; };
  for (int block = 0; block < kBlocks; ++block) {
    const std::size_t o = pixel0 + static_cast<std::size_t>(block) * kLanes;
    const LinePixels line = LoadLines(grid, o);
    hn::Store(line.a, d, field(block, kLineA));
    hn::Store(line.b, d, field(block, kLineB));
    hn::Store(line.s, d, field(block, kLineS));
    hn::Store(line.t, d, field(block, kLineT));
    hn::Store(line.slide, d, field(block, kLineSlide));
    FloatVec behind = hn::Mul(hn::Abs(hn::Load(d, &frame->transmittance[o])),
                              hn::Load(d, gradients.final_transmittance + block * kLanes));
    for (int c = 0; c < 3; ++c) {
      const FloatVec g = hn::Load(d, gradients.color[c] + block * kLanes);
      hn::Store(g, d, field(block, kLineRed + c));
      behind = hn::MulAdd(g, hn::Load(d, &frame->color[c][o]), behind);
    }
    if (with_depth) {
      const FloatVec g = hn::Load(d, gradients.depth + block * kLanes);
      hn::Store(g, d, field(block, kLineAlong));
      behind = hn::MulAdd(g, hn::Load(d, &frame->depth[o]), behind);
      const FloatVec square = hn::Load(d, gradients.distortion + block * kLanes);
      const DepthOfBlock depth(tiles, *frame, o);
      hn::Store(square, d, field(block, kLineSquare));
      hn::Store(depth.mean, d, field(block, kLineMean));
      behind = hn::MulAdd(square, depth.distortion, behind);
    }
    if (with_error) {
      hn::Store(hn::Load(d, gradients.error + block * kLanes), d, field(block, kLineError));
    }
    hn::Store(hn::Load(d, &tiles.start[o]), d, field(block, kLineTransmittance));
    hn::Store(behind, d, field(block, kLineBehind));
    for (int f = kLineToA; f < kNumLineFields; ++f) hn::Store(hn::Zero(d), d, field(block, f));
  }
  const float* bundle = grid.bundles[static_cast<std::size_t>(tile)].values;
  const TileEntry* entries = &frame->entries[frame->tile_begin[tile]];
  LineChunk chunk;
  HWY_ALIGN float totals[16];
  HWY_ALIGN float columns[16][16];
  for (std::uint32_t first = 0; first < count; first += 16) {
    const int here = static_cast<int>(HWY_MIN(count - first, 16u));
    chunk.Fill(frame->records.data(), bundle, task.log2_alpha_min, task.max_cutoff, here,
               [&](int j) { return entries[first + static_cast<std::uint32_t>(j)].gaussian; });
    for (int j = 0; j < here; ++j) {
      FloatVec sums[16];
      for (FloatVec& sum : sums) sum = hn::Zero(d);
      for (std::uint64_t todo = entries[first + static_cast<std::uint32_t>(j)].blocks; todo != 0;
           todo &= todo - 1) {
        BackwardBlock(with_depth, stop_before, with_poses, with_error, chunk, j, task.alpha_max,
                      task.transmittance_min, field(__builtin_ctzll(todo), 0), sums);
      }
      SumLanes16(sums, totals);
      for (int k = 0; k < 16; ++k) columns[k][j] = totals[k];
    }
    StoreSlots(chunk, columns, entries + first, 0, here, frame);
  }
  if (with_poses) {
    for (int block = 0; block < kBlocks; ++block) {
      for (int k = 0; k < 5; ++k) {
        hn::Store(hn::Load(d, field(block, kLineToA + k)), d,
                  to_lines + k * kTilePixels + block * kLanes);
      }
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
