// Loads a vector of Gaussians and places them in the camera frame, for projection and raster alike.

#if defined(GSUT_PROJECTION_SEEN_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_PROJECTION_SEEN_INL_H_
#undef GSUT_PROJECTION_SEEN_INL_H_
#else
#define GSUT_PROJECTION_SEEN_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/gaussians/surfels.h"
#include "gsut/projection/view.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// One Gaussian a lane, in the camera frame.
struct SeenLanes {
  Lane world[3];    // mean - camera centre, world axes
  Lane mean[3];     // the same in camera axes
  Lane distance;    // its length
  Lane quat[4];     // normalised; identity if zero
  Lane quat_scale;  // 1 / norm of the quaternion as stored, 0 if zero
  Lane axes[3][3];  // axes[k]: the Gaussian's axis k in camera axes (columns of Q)
  Lane scale[3];
  Lane opacity;
  Lane log2_strength;  // log2 of the opacity or, under extinction, of -log2(1 - opacity)
  Lane cutoff;         // D^2 beyond which the Gaussian is not drawn
  LaneMask usable;     // can be drawn at all: opacity above the cut-off
};

// Highway's Exp is garbage beyond 104: a larger exponent is taken as this one, the end of float.
inline constexpr double kLargestExponent = 88.5;
// The scale that it leads to, beyond which float ends.
inline constexpr double kLargestLinearScale = 2.7e38;

HWY_INLINE Lane SafeExp(Lane x) {
  return Exp(Select(x > Lane(kLargestExponent), Lane(kLargestExponent), x));
}

// -log2(1 - opacity) = log2(1 + e^logit), from which kernels make alpha = 1 - 2^-raw.
HWY_INLINE Lane DepthInHalvings(Lane logit) {
  constexpr double kLog2E = 1.44269504088896340736;
  constexpr double kMost = 126.0;  // what FastExp2 takes; an alpha of 1 in float long before
  const Lane odds = SafeExp(logit);
  const Lane sum = Lane(1.0) + odds;
  // log(1 + x) = log(sum) x / (sum - 1): the quotient corrects what rounding the sum took.
  const Lane rest = sum - Lane(1.0);
  const LaneMask is_tiny = rest <= Lane(0.0);
  const Lane exact = Log2(sum) * (odds / Select(is_tiny, Lane(1.0), rest));
  return Min(Select(is_tiny, odds * Lane(kLog2E), exact), Lane(kMost));
}

HWY_INLINE Lane Dot3(const Lane* a, const Lane* b) {
  return MulAdd(a[0], b[0], MulAdd(a[1], b[1], a[2] * b[2]));
}

// The rows first .. first + kLanes of an (N, width) array, one lane a row; rows from `count` on
// repeat the last. Width 1, 3 or 4.
HWY_INLINE void LoadRows3(const float* rows, std::int64_t available, Lane* out) {
  const FloatTag d;
  if (available >= kLanes) {
    hn::LoadInterleaved3(d, rows, out[0].v, out[1].v, out[2].v);
    return;
  }
  HWY_ALIGN float padded[3 * kLanes];
  for (int i = 0; i < kLanes; ++i) {
    const std::int64_t row = i < available ? i : available - 1;
    for (int k = 0; k < 3; ++k) padded[3 * i + k] = rows[3 * row + k];
  }
  hn::LoadInterleaved3(d, padded, out[0].v, out[1].v, out[2].v);
}

HWY_INLINE void LoadRows4(const float* rows, std::int64_t available, Lane* out) {
  const FloatTag d;
  if (available >= kLanes) {
    hn::LoadInterleaved4(d, rows, out[0].v, out[1].v, out[2].v, out[3].v);
    return;
  }
  HWY_ALIGN float padded[4 * kLanes];
  for (int i = 0; i < kLanes; ++i) {
    const std::int64_t row = i < available ? i : available - 1;
    for (int k = 0; k < 4; ++k) padded[4 * i + k] = rows[4 * row + k];
  }
  hn::LoadInterleaved4(d, padded, out[0].v, out[1].v, out[2].v, out[3].v);
}

HWY_INLINE Lane LoadRows1(const float* rows, std::int64_t available) {
  const FloatTag d;
  if (available >= kLanes) return Lane(hn::LoadU(d, rows));
  HWY_ALIGN float padded[kLanes];
  for (int i = 0; i < kLanes; ++i) padded[i] = rows[i < available ? i : available - 1];
  return Lane(hn::Load(d, padded));
}

// Row-major rotation of a unit quaternion.
HWY_INLINE void RotationOf(const Lane* q, Lane* r) {
  const Lane one(1.0), two(2.0);
  const Lane w = q[0], x = q[1], y = q[2], z = q[3];
  r[0] = one - two * (y * y + z * z);
  r[1] = two * (x * y - w * z);
  r[2] = two * (x * z + w * y);
  r[3] = two * (x * y + w * z);
  r[4] = one - two * (x * x + z * z);
  r[5] = two * (y * z - w * x);
  r[6] = two * (x * z - w * y);
  r[7] = two * (y * z + w * x);
  r[8] = one - two * (x * x + y * y);
}

// The square of a triangle's gauge where a Gaussian's D^2 would be at its cut-off, see
// gaussians/primitive.h. A cut-off below 0, of what is never drawn, counts as 0.
HWY_INLINE Lane TriangleCutoff(Lane gaussian_cutoff) {
  constexpr double kLeastExponent = -83.0;  // Highway's Exp is garbage far below
  const Lane exponent = Max(Lane(-0.5) * Max(gaussian_cutoff, Lane(0.0)), Lane(kLeastExponent));
  const Lane gauge = Lane(triangle::kRadius) * (Lane(1.0) - Exp(exponent));
  return gauge * gauge;
}

// log2_raw_min: of BlendRule::alpha_min, see Log2RawOf; max_cutoff: of D^2, by response_min.
HWY_INLINE SeenLanes LoadSeen(const GaussiansView<const float>& g, std::int64_t first,
                              const ViewFloats& view, float log2_raw_min, float max_cutoff) {
  SeenLanes out;
  const std::int64_t available = g.size - first;
  LoadRows3(g.means + 3 * first, available, out.world);
  LoadRows4(g.quats + 4 * first, available, out.quat);
  LoadRows3(g.log_scales + 3 * first, available, out.scale);
  const Lane stored_opacity = LoadRows1(g.opacity_logits + first, available);
  const Lane limit(g.is_linear ? kLargestLinearScale : kLargestExponent);
  const LaneMask in_float =
      AndMask(AndMask(out.scale[0] <= limit, out.scale[1] <= limit), out.scale[2] <= limit);
  // The camera's centre as two floats: far from zero the difference keeps its digits.
  for (int k = 0; k < 3; ++k) {
    out.world[k] = (out.world[k] - Lane(view.center_high[k])) - Lane(view.center_low[k]);
    if (!g.is_linear) out.scale[k] = SafeExp(out.scale[k]);
  }
  out.distance = Sqrt(Dot3(out.world, out.world));
  for (int k = 0; k < 3; ++k) {
    const Lane row[3] = {Lane(view.rotation[3 * k]), Lane(view.rotation[3 * k + 1]),
                         Lane(view.rotation[3 * k + 2])};
    out.mean[k] = Dot3(row, out.world);
  }
  // Checked component by component: a maximum may hide what is no number.
  const LaneMask quat_is_finite = AndMask(AndMask(IsFinite(out.quat[0]), IsFinite(out.quat[1])),
                                          AndMask(IsFinite(out.quat[2]), IsFinite(out.quat[3])));
  // The largest component is divided out, so that no norm over- or underflows.
  const Lane largest =
      Max(Max(Abs(out.quat[0]), Abs(out.quat[1])), Max(Abs(out.quat[2]), Abs(out.quat[3])));
  const LaneMask is_zero = largest <= Lane(0.0);
  const Lane inverse_largest = Lane(1.0) / Select(is_zero, Lane(1.0), largest);
  for (Lane& q : out.quat) q *= inverse_largest;
  out.quat[0] = Select(is_zero, Lane(1.0), out.quat[0]);
  const Lane inverse_norm = Lane(1.0) / Sqrt(out.quat[0] * out.quat[0] + out.quat[1] * out.quat[1] +
                                             out.quat[2] * out.quat[2] + out.quat[3] * out.quat[3]);
  for (Lane& q : out.quat) q *= inverse_norm;
  out.quat_scale = Select(is_zero, Lane(0.0), inverse_norm * inverse_largest);
  Lane r[9];
  RotationOf(out.quat, r);
  for (int row = 0; row < 3; ++row) {
    const Lane v0(view.rotation[3 * row]), v1(view.rotation[3 * row + 1]),
        v2(view.rotation[3 * row + 2]);
    for (int k = 0; k < 3; ++k) {
      out.axes[k][row] = MulAdd(v0, r[k], MulAdd(v1, r[3 + k], v2 * r[6 + k]));
    }
  }
  LaneMask usable = AndMask(in_float, quat_is_finite);
  if (g.is_linear) {
    out.opacity = stored_opacity;
    const LaneMask draws = stored_opacity > Lane(0.0);
    out.log2_strength = Log2(Select(draws, stored_opacity, Lane(1.0)));
    const LaneMask has_width = AndMask(out.scale[0] > Lane(0.0),
                                       AndMask(out.scale[1] > Lane(0.0), out.scale[2] > Lane(0.0)));
    usable = AndMask(usable, AndMask(draws, has_width));
  } else {
    // opacity = 1 / (1 + e^-logit), and its logarithm from the same sum: no digits lost near 0.
    const Lane one_plus = Lane(1.0) + SafeExp(-stored_opacity);
    out.opacity = Lane(1.0) / one_plus;
    out.log2_strength = -Log2(one_plus);
    if (g.response == Response::kExtinction) {
      out.log2_strength = Log2(DepthInHalvings(stored_opacity));
    }
  }
  constexpr double kTwoLn2 = 1.38629436111989061883;
  const Lane cutoff = Lane(kTwoLn2) * (out.log2_strength - Lane(log2_raw_min));
  out.cutoff = Min(cutoff, Lane(max_cutoff));
  out.usable = AndMask(AndMask(cutoff > Lane(0.0), IsFinite(stored_opacity)), usable);
  if (HWY_UNLIKELY(IsFlat(g.primitive))) {
    out.cutoff = TriangleCutoff(out.cutoff);
    out.scale[2] = Min(out.scale[0], out.scale[1]) * Lane(kSurfelThickness);
  }
  return out;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
