// A Gaussian as the lines of a tile see it: the residual-first form of its response.
//
// In the frame (D, E1, E2) of a bundle of lines a E1 + b E2 + x (D + s E1 + t E2), let m be the
// Gaussian's mean, sd^2 its variance along D, and M = S^-1 R^T. In whitened coordinates turned so
// that M E1 = (x_a, y_a, 0) and M E2 = (x_b, y_b, 0), a direction has M (D + s E1 + t E2) =
// (w_x, w_y, 1) / sd, and the line meets the plane x = m.D through the mean at a distance from it
// of
//   e_x = x_a A + x_b B, e_y = y_a A + y_b B, A = (m.E1 - a) - (m.D) s, B = (m.E2 - b) - (m.D) t:
// the differences are taken first, from small numbers, so that float keeps its digits. The turn
// within the plane makes (x_a, x_b) and (y_a, y_b) orthogonal: bounds by intervals are tight. Then
//   tau = (e.w) / (1 + w_x^2 + w_y^2), residual = (e_x + c w_y, e_y - c w_x, -e.w) / (1 + |w|^2),
//   c = e_x w_y - e_y w_x, D^2 = |residual|^2 = (|e|^2 + c^2) / (1 + |w|^2),
// and the nearest point lies at x = m.D + sd tau. No large numbers cancel, also where a Gaussian is
// so thin (a surfel) that e and w are.
// e is divided by the square root k of the cut-off of D^2, so that a Gaussian is drawn where
// u = |residual|^2 < 1.

#if defined(GSUT_RASTER_LINES_PAIR_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_PAIR_INL_H_
#undef GSUT_RASTER_LINES_PAIR_INL_H_
#else
#define GSUT_RASTER_LINES_PAIR_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/blend_tile-inl.h"
#include "gsut/raster/line_grid.h"
#include "gsut/raster/lines/flat-inl.h"
#include "gsut/raster/lines/gaussian_lanes-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// 1 / sqrt(x) to within an ulp or two, x > 0 and in float's range.
HWY_INLINE Lane InverseRoot(Lane x) {
#if GSUT_DIVIDES
  return Lane(1.0) / Sqrt(x);
#else
  const Lane r(hn::ApproximateReciprocalSqrt(x.v));
  return r * (Lane(1.5) - Lane(0.5) * x * r * r);
#endif
}

// What a Gaussian is in the frame of a bundle.
struct LinePair {
  Lane m[3];                // mean along E1, E2, D
  Lane x_a, x_b, y_a, y_b;  // over k
  Lane w_x0, w_xs, w_xt;    // w_x = w_x0 + w_xs s + w_xt t
  Lane w_y0, w_ys, w_yt;
  Lane reach;         // k sd: how far along D it reaches
  Lane q1[3], q2[3];  // axes x, y of the turned whitened frame, in the Gaussian's own
};

// axes[3 k + j]: component j of D, E1, E2.
HWY_INLINE LinePair PlaceInFrame(const GaussianLanes& g, const Lane* axes) {
  LinePair p;
  const Lane* d = axes;
  const Lane* e1 = axes + 3;
  const Lane* e2 = axes + 6;
  p.m[0] = Dot3(g.mean, e1);
  p.m[1] = Dot3(g.mean, e2);
  p.m[2] = Dot3(g.mean, d);
  Lane w0[3], w1[3], w2[3], normal[3];
  for (int k = 0; k < 3; ++k) {
    w0[k] = Dot3(g.whiten[k], d);
    w1[k] = Dot3(g.whiten[k], e1);
    w2[k] = Dot3(g.whiten[k], e2);
    normal[k] = g.variance[k] * w0[k];  // across M E1 and M E2: exact, also for needles
  }
  // First so that M E1 = (alpha, 0, 0) and M E2 = (beta, gamma, 0).
  const Lane square = Dot3(w1, w1), variance = Dot3(normal, normal);
  const Lane inverse_alpha = InverseRoot(square), inverse_sd = InverseRoot(variance);
  const Lane alpha = square * inverse_alpha, sd = variance * inverse_sd;
  Lane q1[3], q2[3];
  for (int k = 0; k < 3; ++k) {
    q1[k] = w1[k] * inverse_alpha;
    normal[k] *= inverse_sd;
  }
  q2[0] = normal[1] * q1[2] - normal[2] * q1[1];
  q2[1] = normal[2] * q1[0] - normal[0] * q1[2];
  q2[2] = normal[0] * q1[1] - normal[1] * q1[0];
  const Lane beta = Dot3(q1, w2);
  const Lane gamma = g.inverse_volume * inverse_alpha * sd;  // exact, too
  // Then one Jacobi rotation, which makes the rows (alpha, beta) and (0, gamma) orthogonal.
  const Lane gap = gamma * gamma - (alpha * alpha + beta * beta);
  const Lane twice = Lane(2.0) * beta * gamma;
  const Lane below = Abs(gap) + Sqrt(gap * gap + twice * twice);
  const Lane tangent = Select(gap >= Lane(0.0), Lane(1.0), Lane(-1.0)) * twice /
                       Select(below > Lane(0.0), below, Lane(1.0));
  const Lane cosine = InverseRoot(MulAdd(tangent, tangent, Lane(1.0)));
  const Lane sine = cosine * tangent;
  const Lane first[2] = {cosine * alpha, cosine * beta - sine * gamma};
  const Lane second[2] = {sine * alpha, sine * beta + cosine * gamma};
  const Lane first2 = first[0] * first[0] + first[1] * first[1];
  const Lane second2 = second[0] * second[0] + second[1] * second[1];
  // The longer row keeps its digits; the other is orthogonal to it, with the area alpha gamma.
  const LaneMask first_is_long = first2 >= second2;
  const Lane ratio = alpha * gamma / Max(first2, second2);
  p.x_a = Select(first_is_long, first[0], second[1] * ratio) * g.inverse_k;
  p.x_b = Select(first_is_long, first[1], -(second[0] * ratio)) * g.inverse_k;
  p.y_a = Select(first_is_long, -(first[1] * ratio), second[0]) * g.inverse_k;
  p.y_b = Select(first_is_long, first[0] * ratio, second[1]) * g.inverse_k;
  for (int k = 0; k < 3; ++k) {
    p.q1[k] = cosine * q1[k] - sine * q2[k];
    p.q2[k] = sine * q1[k] + cosine * q2[k];
  }
  p.reach = g.k * sd;
  p.w_x0 = Dot3(p.q1, w0) * sd;
  p.w_y0 = Dot3(p.q2, w0) * sd;
  p.w_xs = p.x_a * p.reach;
  p.w_xt = p.x_b * p.reach;
  p.w_ys = p.y_a * p.reach;
  p.w_yt = p.y_b * p.reach;
  return p;
}

// Whether lines whose a, b, s, t lie within center +- half, none with its origin beyond `slide`,
// may hit the Gaussian: interval bounds, never too narrow. A value that is no number counts as a
// hit.
HWY_INLINE LaneMask MayHit(const LinePair& p, const Lane* center, const Lane* half, Lane slide) {
  // Rounding of the mean in the frame, and of what is made of it.
  constexpr double kRounding = 1e-6;
  const Lane slack = Lane(kRounding) * (Abs(p.m[0]) + Abs(p.m[1]) + Abs(p.m[2]));
  const Lane x = Abs(p.m[2]);
  const Lane a = (p.m[0] - center[0]) - p.m[2] * center[2];
  const Lane b = (p.m[1] - center[1]) - p.m[2] * center[3];
  const Lane half_a = half[0] + x * half[2] + slack;
  const Lane half_b = half[1] + x * half[3] + slack;
  const Lane e_x = p.x_a * a + p.x_b * b;
  const Lane e_y = p.y_a * a + p.y_b * b;
  const Lane half_x = Abs(p.x_a) * half_a + Abs(p.x_b) * half_b;
  const Lane half_y = Abs(p.y_a) * half_a + Abs(p.y_b) * half_b;
  const Lane w_x = p.w_x0 + p.w_xs * center[2] + p.w_xt * center[3];
  const Lane w_y = p.w_y0 + p.w_ys * center[2] + p.w_yt * center[3];
  const Lane half_wx = Abs(p.w_xs) * half[2] + Abs(p.w_xt) * half[3];
  const Lane half_wy = Abs(p.w_ys) * half[2] + Abs(p.w_yt) * half[3];
  const Lane zero(0.0), one(1.0);
  const Lane least_x = Max(Abs(e_x) - half_x, zero);
  const Lane least_y = Max(Abs(e_y) - half_y, zero);
  const Lane cross = Abs(e_x * w_y - e_y * w_x);
  const Lane half_cross = Abs(e_x) * half_wy + Abs(w_y) * half_x + half_x * half_wy +
                          Abs(e_y) * half_wx + Abs(w_x) * half_y + half_y * half_wx;
  const Lane least_cross = Max(cross - half_cross, zero);
  const Lane most_wx = Abs(w_x) + half_wx, most_wy = Abs(w_y) + half_wy;
  // |residual|^2 = (|e|^2 + (e x w)^2) / (1 + |w|^2).
  const Lane least = least_x * least_x + least_y * least_y + least_cross * least_cross;
  const Lane most = one + most_wx * most_wx + most_wy * most_wy;
  constexpr double kRelative = 1e-5;
  const LaneMask misses = least >= most * Lane(1.0 + kRelative);
  const LaneMask behind = p.m[2] + p.reach + slack < slide;
  return NotMask(OrMask(misses, behind));
}

// The pairs of a chunk of a tile, a column of floats a value.
struct LineChunk {
  enum Column {
    kM1,
    kM2,
    kMd,
    kXa,
    kXb,
    kYa,
    kYb,
    kWx0,
    kWxs,
    kWxt,
    kWy0,
    kWys,
    kWyt,
    kReach,
    kKappa,
    kLog2Strength,
    kRed,
    kGreen,
    kBlue,
    kQ1,
    kQ2 = kQ1 + 3,
    kColumns = kQ2 + 3,
    // Of triangles, which have X in kWx0, kXa and kXb and Y likewise.
    kNormal = kQ1,
    kEnd = kWxt
  };
  // Of X, Y and n: along D, E1 and E2.
  static constexpr int kColumnsOf[3][3] = {
      {kWx0, kXa, kXb}, {kWy0, kYa, kYb}, {kNormal, kNormal + 1, kNormal + 2}};
  // Places for kChunk pairs and kMissing, rounded up to whole vectors.
  static constexpr int kStride = kChunk + 16;
  HWY_ALIGN float values[kColumns][kStride];

  HWY_INLINE LineChunk() {
    for (int c = 0; c < kColumns; ++c) values[c][kMissing] = 0.0f;
    // Far beside any line.
    values[kXa][kMissing] = 1.0f;
    values[kM1][kMissing] = 1e9f;
  }

  // Sets up the Gaussians ids[0 .. count) for a tile.
  template <bool kIsFlat, class Ids>
  HWY_INLINE void Fill(const RasterTask& task, const float* records, const float* bundle, int count,
                       const Ids& ids) {
    const FloatTag d;
    Lane axes[9];
    for (int k = 0; k < 9; ++k) axes[k] = Lane(bundle[LineBundle::kD + k]);
    for (int first = 0; first < count; first += kLanes) {
      HWY_ALIGN float rows[record::kSize][kLanes];
      for (int i = 0; i < kLanes; ++i) {
        const float* row =
            records + std::size_t{record::kSize} * ids(first + i < count ? first + i : first);
        for (int k = 0; k < record::kSize; ++k) rows[k][i] = row[k];
      }
      const auto load = [&](int k) HWY_ATTR { return Lane(hn::Load(d, rows[k])); };
      const GaussianLanes g = LoadGaussians(task, load);
      const auto store = [&](int column, Lane value)
                             HWY_ATTR { hn::Store(value.v, d, values[column] + first); };
      constexpr double kHalfLog2E = 0.72134752044448170368;
      store(kKappa, Lane(-kHalfLog2E) * g.cutoff);
      store(kLog2Strength, g.log2_strength);
      for (int c = 0; c < 3; ++c) store(kRed + c, load(line_record::kColor + c));
      if constexpr (kIsFlat) {
        StoreFlat(PlaceFlat(g, axes), store);
        continue;
      }
      const LinePair p = PlaceInFrame(g, axes);
      store(kM1, p.m[0]);
      store(kM2, p.m[1]);
      store(kMd, p.m[2]);
      store(kXa, p.x_a);
      store(kXb, p.x_b);
      store(kYa, p.y_a);
      store(kYb, p.y_b);
      store(kWx0, p.w_x0);
      store(kWxs, p.w_xs);
      store(kWxt, p.w_xt);
      store(kWy0, p.w_y0);
      store(kWys, p.w_ys);
      store(kWyt, p.w_yt);
      store(kReach, p.reach);
      for (int k = 0; k < 3; ++k) {
        store(kQ1 + k, p.q1[k]);
        store(kQ2 + k, p.q2[k]);
      }
    }
  }

  // store(column, value).
  template <class Store>
  HWY_INLINE static void StoreFlat(const FlatPair& p, Store&& store) {
    for (int k = 0; k < 3; ++k) {
      store(kM1 + k, p.m[k]);
      store(kColumnsOf[0][k], p.x[k]);
      store(kColumnsOf[1][k], p.y[k]);
      store(kColumnsOf[2][k], p.n[k]);
    }
    store(kEnd, p.end);
  }

  HWY_INLINE FloatVec Get(int column, int pair) const {
    return hn::Set(FloatTag(), values[column][pair]);
  }

  // Returns the bits of visit(centre, half) over the blocks of a tile, a block a lane.
  template <class Visit>
  HWY_INLINE static std::uint64_t VisitBlocks(const float* boxes, int block_stride, Visit&& visit) {
    const FloatTag d;
    std::uint64_t blocks = 0;
    for (int b = 0; b < block_stride; b += kLanes) {
      Lane center[4], half[4];
      for (int k = 0; k < 4; ++k) {
        center[k] = Lane(hn::Load(d, boxes + k * block_stride + b));
        half[k] = Lane(hn::Load(d, boxes + (4 + k) * block_stride + b));
      }
      blocks |= MaskBits(visit(center, half).m) << b;
    }
    return blocks;
  }

  // As TouchedBlocks, of a triangle.
  HWY_INLINE std::uint64_t TouchedFlat(int pair, const float* boxes, int block_stride) const {
    const auto get = [&](int column) HWY_ATTR { return Lane(Get(column, pair)); };
    FlatPair p;
    for (int k = 0; k < 3; ++k) {
      p.m[k] = get(kM1 + k);
      p.x[k] = get(kColumnsOf[0][k]);
      p.y[k] = get(kColumnsOf[1][k]);
      p.n[k] = get(kColumnsOf[2][k]);
    }
    return VisitBlocks(boxes, block_stride, [&](const Lane* center, const Lane* half) HWY_ATTR {
      return MayHitFlat(p, center, half);
    });
  }

  // Bit b set where block b of the tile may hold a pixel that sees the pair.
  HWY_INLINE std::uint64_t TouchedBlocks(int pair, const float* boxes, int block_stride,
                                         float slide) const {
    const auto get = [&](int column) HWY_ATTR { return Lane(Get(column, pair)); };
    LinePair p;
    for (int k = 0; k < 3; ++k) p.m[k] = get(kM1 + k);
    p.x_a = get(kXa);
    p.x_b = get(kXb);
    p.y_a = get(kYa);
    p.y_b = get(kYb);
    p.w_x0 = get(kWx0);
    p.w_xs = get(kWxs);
    p.w_xt = get(kWxt);
    p.w_y0 = get(kWy0);
    p.w_ys = get(kWys);
    p.w_yt = get(kWyt);
    p.reach = get(kReach);
    return VisitBlocks(boxes, block_stride, [&](const Lane* center, const Lane* half) HWY_ATTR {
      return MayHit(p, center, half, Lane(slide));
    });
  }
};

// Response of one pair at a block of pixels.
struct LineHit {
  FloatVec tau;                   // minus the residual's third component, over k
  FloatVec u;                     // the residual's square
  FloatVec x;                     // where the nearest point lies on the line
  FloatVec e_x, e_y, c;           // over k
  FloatVec w_x, w_y, reciprocal;  // 1 / (1 + w_x^2 + w_y^2)
};

struct LinePixels {
  FloatVec a, b, s, t, slide;
};

HWY_INLINE LineHit HitOf(const LineChunk& chunk, int j, const LinePixels& line) {
  using C = LineChunk;
  const FloatTag d;
  LineHit hit;
  const FloatVec depth = chunk.Get(C::kMd, j);
  const FloatVec a = hn::NegMulAdd(depth, line.s, hn::Sub(chunk.Get(C::kM1, j), line.a));
  const FloatVec b = hn::NegMulAdd(depth, line.t, hn::Sub(chunk.Get(C::kM2, j), line.b));
  hit.e_x = hn::MulAdd(chunk.Get(C::kXa, j), a, hn::Mul(chunk.Get(C::kXb, j), b));
  hit.e_y = hn::MulAdd(chunk.Get(C::kYa, j), a, hn::Mul(chunk.Get(C::kYb, j), b));
  hit.w_x = hn::MulAdd(chunk.Get(C::kWxs, j), line.s,
                       hn::MulAdd(chunk.Get(C::kWxt, j), line.t, chunk.Get(C::kWx0, j)));
  hit.w_y = hn::MulAdd(chunk.Get(C::kWys, j), line.s,
                       hn::MulAdd(chunk.Get(C::kWyt, j), line.t, chunk.Get(C::kWy0, j)));
  hit.reciprocal =
      FastReciprocal(hn::MulAdd(hit.w_x, hit.w_x, hn::MulAdd(hit.w_y, hit.w_y, hn::Set(d, 1.0f))));
  hit.tau = hn::Mul(hn::MulAdd(hit.e_x, hit.w_x, hn::Mul(hit.e_y, hit.w_y)), hit.reciprocal);
  hit.c = hn::MulSub(hit.e_x, hit.w_y, hn::Mul(hit.e_y, hit.w_x));
  hit.u = hn::Mul(hit.reciprocal, hn::MulAdd(hit.e_x, hit.e_x,
                                             hn::MulAdd(hit.e_y, hit.e_y, hn::Mul(hit.c, hit.c))));
  hit.x = hn::MulAdd(chunk.Get(C::kReach, j), hit.tau, depth);
  return hit;
}

// Drawn: inside the cut-off, and in front of the line's own origin.
HWY_INLINE FloatMask IsHit(const LineHit& hit, const LinePixels& line) {
  return hn::And(hn::Lt(hit.u, hn::Set(FloatTag(), 1.0f)), hn::Gt(hit.x, line.slide));
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
