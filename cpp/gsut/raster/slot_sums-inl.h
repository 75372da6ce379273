// Sums the slots of Gaussians, and takes gradients on to colours, quaternions and the rows of the
// arrays, for any kind of rays.

#if defined(GSUT_RASTER_SLOT_SUMS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_SLOT_SUMS_INL_H_
#undef GSUT_RASTER_SLOT_SUMS_INL_H_
#else
#define GSUT_RASTER_SLOT_SUMS_INL_H_
#endif

#include "gsut/gaussians/adam-inl.h"
#include "gsut/projection/seen-inl.h"
#include "gsut/raster/frame.h"
#include "gsut/raster/harmonics-inl.h"
#include "gsut/raster/task.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Whether a pixel may have seen one of `count` Gaussians.
HWY_INLINE bool MayBeSeen(const Frame& frame, std::int64_t first, std::int64_t count) {
  return frame.slot_begin[first] < frame.slot_begin[first + count];
}

// Fetches the slots of a Gaussian: a cache line each.
HWY_INLINE void FetchSlots(const Frame& frame, std::int64_t gaussian) {
  const std::uint32_t end = frame.slot_begin[gaussian + 1];
  for (std::uint32_t slot = frame.slot_begin[gaussian]; slot < end; ++slot) {
    __builtin_prefetch(&frame.slot_gradients[std::size_t{16} * slot]);
  }
}

// Adds up the touched slots of one Gaussian, in order; returns whether there was any.
HWY_INLINE bool SumSlots(const Frame& frame, std::int64_t gaussian, float* sums) {
  const FloatTag d;
  constexpr int kVectors = 16 / kLanes;
  FloatVec total[kVectors];
  for (FloatVec& v : total) v = hn::Zero(d);
  bool touched = false;
  const std::uint32_t end = frame.slot_begin[gaussian + 1];
  for (std::uint32_t slot = frame.slot_begin[gaussian]; slot < end; ++slot) {
    if (!frame.slot_touched[slot]) continue;
    touched = true;
    const float* row = &frame.slot_gradients[std::size_t{16} * slot];
    for (int k = 0; k < kVectors; ++k) {
      total[k] = hn::Add(total[k], hn::Load(d, row + k * kLanes));
    }
  }
  for (int k = 0; k < kVectors; ++k) hn::Store(total[k], d, sums + k * kLanes);
  return touched;
}

// Writes the rows first .. of an (N, 3) array from lanes, `available` of them.
HWY_INLINE void StoreRows3(const Lane* v, std::int64_t available, float* rows) {
  const FloatTag d;
  if (available >= kLanes) {
    hn::StoreInterleaved3(v[0].v, v[1].v, v[2].v, d, rows);
    return;
  }
  HWY_ALIGN float padded[3 * kLanes];
  hn::StoreInterleaved3(v[0].v, v[1].v, v[2].v, d, padded);
  for (std::int64_t i = 0; i < 3 * available; ++i) rows[i] = padded[i];
}

HWY_INLINE void StoreRows4(const Lane* v, std::int64_t available, float* rows) {
  const FloatTag d;
  if (available >= kLanes) {
    hn::StoreInterleaved4(v[0].v, v[1].v, v[2].v, v[3].v, d, rows);
    return;
  }
  HWY_ALIGN float padded[4 * kLanes];
  hn::StoreInterleaved4(v[0].v, v[1].v, v[2].v, v[3].v, d, padded);
  for (std::int64_t i = 0; i < 4 * available; ++i) rows[i] = padded[i];
}

HWY_INLINE void StoreRows1(Lane v, std::int64_t available, float* rows) {
  const FloatTag d;
  if (available >= kLanes) {
    hn::StoreU(v.v, d, rows);
    return;
  }
  HWY_ALIGN float padded[kLanes];
  hn::Store(v.v, d, padded);
  for (std::int64_t i = 0; i < available; ++i) rows[i] = padded[i];
}

// The Gaussians [first, first + kLanes) that exist: which of them a pixel saw, and the sums[16]
// over their slots. False if none was seen; touched is set, and with write_untouched rows become 0.
HWY_INLINE bool LoadSlotSums(const GaussiansView<const float>& g, std::int64_t first,
                             const Frame& frame, const GradientRows& to, LaneMask* seen,
                             Lane* sums) {
  const FloatTag d;
  const std::int64_t available = HWY_MIN(g.size - first, static_cast<std::int64_t>(kLanes));
  const NextHarmonics next(g, first);
  const bool fetch = MayBeSeen(frame, first + available, next.count);
  HWY_ALIGN float rows[kLanes][16];
  bool any = false;
  HWY_ALIGN float seen_flag[kLanes];
  for (int i = 0; i < kLanes; ++i) {
    if (fetch && i < next.count) {
      FetchSlots(frame, first + kLanes + i);
      next.Fetch<false>(g.sh, i, next.stride);
      if (to.step == nullptr) next.Fetch<true>(to.rows.sh, i, next.stride);
    }
    const bool is_seen = i < available && SumSlots(frame, first + i, rows[i]);
    seen_flag[i] = is_seen ? 1.0f : 0.0f;
    if (i < available) to.touched[first + i] = is_seen;
    if (i >= available) {
      for (float& x : rows[i]) x = 0.0f;
    }
    any = any || is_seen;
  }
  if (!any) {
    if (to.write_untouched) {
      const GaussiansView<float>& out = to.rows;
      __builtin_memset(out.means + 3 * first, 0, sizeof(float) * 3 * available);
      __builtin_memset(out.quats + 4 * first, 0, sizeof(float) * 4 * available);
      __builtin_memset(out.log_scales + 3 * first, 0, sizeof(float) * 3 * available);
      __builtin_memset(out.opacity_logits + first, 0, sizeof(float) * available);
      const std::int64_t stride = 3 * g.sh_coefficients;
      __builtin_memset(out.sh + stride * first, 0, sizeof(float) * stride * available);
    }
    return false;
  }
  *seen = {hn::Gt(hn::Load(d, seen_flag), hn::Zero(d))};
  LoadColumns(rows[0], 16, 16, sums);
  if (to.error_sums != nullptr) {
    for (int i = 0; i < available; ++i) to.error_sums[first + i] += rows[i][slot::kError];
  }
  return true;
}

// Steps the harmonics of those of [first, first + kLanes) that were seen; columns: of their
// gradients, the first step.active. Fetches moments of the batch after it.
HWY_INLINE void StepHarmonics(const HarmonicsStep& step, const GaussiansView<const float>& g,
                              std::int64_t first, const Frame& frame, LaneMask seen,
                              const Lane* columns) {
  const FloatTag d;
  constexpr int kRow = PaddedColumns(3 * kMaxShCoefficients);
  HWY_ALIGN float gradients[kLanes * kRow];
  for (int c = 0; c < step.active; c += kLanes) {
    FloatVec v[kLanes];
    GSUT_UNROLL for (int i = 0; i < kLanes; ++i) v[i] = columns[c + i].v;
    TransposeLanes(v);
    GSUT_UNROLL for (int i = 0; i < kLanes; ++i) hn::Store(v[i], d, gradients + i * kRow + c);
  }
  const std::int64_t stride = 3 * g.sh_coefficients;
  const NextHarmonics next(g, first);
  const std::uint64_t bits = MaskBits(seen.m);
  // Adam's step is sparse: a row that no pixel saw keeps its parameters and its moments.
  for (int i = 0; i < kLanes; ++i) {
    if (i < next.count && MayBeSeen(frame, first + kLanes + i, 1)) {
      next.Fetch<true>(step.moment1, i, step.active);
      next.Fetch<true>(step.moment2, i, step.active);
    }
    if (!((bits >> i) & 1)) continue;
    const std::int64_t at = (first + i) * stride;
    UpdateRange<true>(step.constants, static_cast<std::size_t>(step.active), step.rates.data(),
                      gradients + i * kRow, step.params + at, step.moment1 + at, step.moment2 + at);
  }
}

// c = max(0, 0.5 + sum over k of Y_k(n) h_k), n the direction of view. With g = dL/dc where c > 0,
// else 0:
//   dL/dh_k = Y_k(n) g,  dL/dn = sum over k of (h_k . g) dY_k/dn.
// From dL/dcolor to the harmonics, written or stepped, and to the direction they were evaluated in.
HWY_INLINE void ColorGradients(const GaussiansView<const float>& g, std::int64_t first, int degree,
                               const Frame& frame, LaneMask seen, const Lane* direction,
                               const Lane* to_color, const GradientRows& to, Lane* g_direction) {
  const std::int64_t available = HWY_MIN(g.size - first, static_cast<std::int64_t>(kLanes));
  const HarmonicsColumns sh(g, degree, first);
  Lane color[3];
  Lane basis[kMaxShCoefficients];
  Lane g_basis[kMaxShCoefficients];
  HarmonicsBasis(degree, direction[0], direction[1], direction[2], basis);
  EvalColor(degree, basis, sh, color);
  Lane g_color[3];
  for (int c = 0; c < 3; ++c) {
    g_color[c] = Select(AndMask(seen, color[c] > Lane(0.0)), to_color[c], Lane(0.0));
  }
  const int used = NumShCoefficients(degree);
  const std::int64_t stride = 3 * g.sh_coefficients;
  Lane g_sh[PaddedColumns(3 * kMaxShCoefficients)];
  for (int k = 0; k < used; ++k) {
    g_basis[k] = Lane(0.0);
    for (int c = 0; c < 3; ++c) {
      g_basis[k] = MulAdd(sh.column[3 * k + c], g_color[c], g_basis[k]);
      // A row that is not drawn may have a direction that is no number.
      g_sh[3 * k + c] = Select(seen, basis[k] * g_color[c], Lane(0.0));
    }
  }
  const int count = to.step == nullptr ? static_cast<int>(stride) : to.step->active;
  for (int k = 3 * used; k < PaddedColumns(count); ++k) g_sh[k] = Lane(0.0);
  if (to.step != nullptr) {
    StepHarmonics(*to.step, g, first, frame, seen, g_sh);
  } else if (stride == 3) {
    StoreRows3(g_sh, available, to.rows.sh + first * stride);
  } else {
    StoreColumns(g_sh, stride, available, to.rows.sh + first * stride);
  }
  HarmonicsBasisGradient(degree, direction[0], direction[1], direction[2], g_basis, g_direction);
}

// A turn by w (world or camera axes, the same on both sides) of a unit quaternion q: q + (0, w) q
// / 2. From the gradient to w to that to the quaternion as stored.
// The four numbers (0, w) q / 2 have half the length of w, in directions across q: dL/dq = 2 (0, g)
// q for the gradient g to w. A stored quaternion that is k q gets 1 / k of it.
HWY_INLINE void TurnFromLeft(const SeenLanes& s, const Lane* turn, Lane* to_quat) {
  const Lane two = Lane(2.0) * s.quat_scale;
  const Lane w = s.quat[0], x = s.quat[1], y = s.quat[2], z = s.quat[3];
  to_quat[0] = two * -(turn[0] * x + turn[1] * y + turn[2] * z);
  to_quat[1] = two * (turn[0] * w + turn[1] * z - turn[2] * y);
  to_quat[2] = two * (turn[1] * w + turn[2] * x - turn[0] * z);
  to_quat[3] = two * (turn[2] * w + turn[0] * y - turn[1] * x);
}

// The same for a turn about the Gaussian's own axes: q + q (0, w) / 2.
HWY_INLINE void TurnFromRight(const SeenLanes& s, const Lane* turn, Lane* to_quat) {
  const Lane two = Lane(2.0) * s.quat_scale;
  const Lane w = s.quat[0], x = s.quat[1], y = s.quat[2], z = s.quat[3];
  to_quat[0] = two * -(turn[0] * x + turn[1] * y + turn[2] * z);
  to_quat[1] = two * (turn[0] * w - turn[1] * z + turn[2] * y);
  to_quat[2] = two * (turn[1] * w - turn[2] * x + turn[0] * z);
  to_quat[3] = two * (turn[2] * w - turn[0] * y + turn[1] * x);
}

// Gradients to the parameters of a batch of Gaussians; means in world axes.
struct ParameterGradients {
  Lane mean[3], quat[4], log_scale[3], logit;
};

// From h, the sum of strength x dL/dstrength, to the gradient of the opacity as stored.
HWY_INLINE Lane OpacityGradient(const SeenLanes& s, Response response, bool is_linear, Lane h) {
  if (response == Response::kExtinction) {
    // The logit changes ln(1 + e^logit) by the opacity.
    constexpr double kLn2 = 0.69314718055994530942;
    return h * s.opacity / (Lane(kLn2) * Exp(Lane(kLn2) * s.log2_strength));
  }
  return is_linear ? h / s.opacity : h * (Lane(1.0) - s.opacity);
}

// Writes the rows [first, first + kLanes) that exist; those that no pixel saw become 0.
HWY_INLINE void StoreGradients(ParameterGradients of, const SeenLanes& s, LaneMask seen,
                               std::int64_t first, const GaussiansView<float>& rows) {
  for (int k = 0; rows.is_linear && k < 3; ++k) of.log_scale[k] = of.log_scale[k] / s.scale[k];
  const std::int64_t available = HWY_MIN(rows.size - first, static_cast<std::int64_t>(kLanes));
  Lane quat[4], log_scale[3];
  for (int k = 0; k < 4; ++k) quat[k] = Select(seen, of.quat[k], Lane(0.0));
  for (int k = 0; k < 3; ++k) log_scale[k] = Select(seen, of.log_scale[k], Lane(0.0));
  StoreRows3(of.mean, available, rows.means + 3 * first);
  StoreRows4(quat, available, rows.quats + 4 * first);
  StoreRows3(log_scale, available, rows.log_scales + 3 * first);
  StoreRows1(Select(seen, of.logit, Lane(0.0)), available, rows.opacity_logits + first);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
