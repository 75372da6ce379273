// From the sums V and K over a Gaussian's lines (backward-inl.h) to its parameters.
//
// With r = M (mean - nearest point) over k, dL/dM M^T = -cut-off K and M^T dL/d(M mean) =
// -k M^T V, both to D^2 as it is: the mean gets -k R S^-1 V, the logarithm of scale i cut-off K_ii,
// and a turn about the Gaussian's own axis z -cut-off K_xy (s_y / s_x - s_x / s_y), and so on. No
// difference of large numbers occurs, needles included. A triangle's sums are of another kind
// (flat_backward-inl.h): along its normal the mean gets cut-off V_z, and turns about x and y are
// moments of that.

#if defined(GSUT_RASTER_LINES_GRADIENTS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_LINES_GRADIENTS_INL_H_
#undef GSUT_RASTER_LINES_GRADIENTS_INL_H_
#else
#define GSUT_RASTER_LINES_GRADIENTS_INL_H_
#endif

#include "gsut/raster/lines/backward-inl.h"
#include "gsut/raster/slot_sums-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// Where Gaussians are shaded from: their own direction, or the axis of parallel rays.
HWY_INLINE void ShadingDirection(const SeenLanes& s, const ViewFloats& view, bool is_parallel,
                                 Lane* direction) {
  const Lane inverse_distance = Lane(1.0) / s.distance;
  for (int k = 0; k < 3; ++k) {
    direction[k] = is_parallel ? Lane(view.rotation[6 + k]) : s.world[k] * inverse_distance;
  }
}

// As GaussianGradients; dshading[6]: to the reference's centre and to its axis, world.
HWY_INLINE void LineGradients(const RasterTask& task, bool is_parallel, std::int64_t first,
                              const Frame& frame, const GradientRows& to, double* dshading) {
  const FloatTag d;
  const GaussiansView<const float>& g = task.gaussians;
  const ViewFloats& view = task.view;
  const std::int64_t available = HWY_MIN(g.size - first, static_cast<std::int64_t>(kLanes));
  LaneMask seen;
  Lane sums[16];
  if (!LoadSlotSums(g, first, frame, to, &seen, sums)) return;
  const SeenLanes s = LoadSeen(g, first, view, task.log2_raw_min, task.max_cutoff);
  ParameterGradients out;
  const Lane k = Sqrt(s.cutoff);
  Lane to_mean[3];  // camera frame
  const bool is_flat = IsFlat(g.primitive);
  const Lane to_axes[3] = {
      k * sums[line_slot::kV] / s.scale[0], k * sums[line_slot::kV + 1] / s.scale[1],
      is_flat ? s.cutoff * sums[line_slot::kV + 2] : k * sums[line_slot::kV + 2] / s.scale[2]};
  for (int j = 0; j < 3; ++j) {
    to_mean[j] =
        -(s.axes[0][j] * to_axes[0] + s.axes[1][j] * to_axes[1] + s.axes[2][j] * to_axes[2]);
  }
  const Lane* kk = &sums[line_slot::kK];  // K_xx, K_xy, K_xz, K_yy, K_yz, K_zz
  const Lane diagonal[3] = {kk[0], kk[3], is_flat ? Lane(0.0) : kk[5]};
  for (int j = 0; j < 3; ++j) out.log_scale[j] = s.cutoff * diagonal[j];
  const auto turn_about = [&](Lane off_diagonal, int i, int j) HWY_ATTR {
    return -(s.cutoff * off_diagonal * (s.scale[j] / s.scale[i] - s.scale[i] / s.scale[j]));
  };
  Lane turn[3] = {turn_about(kk[4], 1, 2), turn_about(kk[2], 2, 0), turn_about(kk[1], 0, 1)};
  if (HWY_UNLIKELY(is_flat)) {
    const Lane ratio = s.scale[1] / s.scale[0];
    turn[0] = -(s.cutoff * k * s.scale[1] * kk[5]);
    turn[1] = s.cutoff * k * s.scale[0] * kk[4];
    turn[2] = s.cutoff * (kk[2] / ratio - kk[1] * ratio);
  }
  TurnFromRight(s, turn, out.quat);

  Lane direction[3], to_direction[3];
  ShadingDirection(s, view, is_parallel, direction);
  ColorGradients(g, first, task.sh_degree, frame, seen, direction, &sums[slot::kColor], to,
                 to_direction);
  const Lane along = Dot3(direction, to_direction);
  const Lane inverse_distance = Lane(1.0) / s.distance;
  for (int j = 0; j < 3; ++j) {
    const Lane column[3] = {Lane(view.rotation[j]), Lane(view.rotation[3 + j]),
                            Lane(view.rotation[6 + j])};
    out.mean[j] = Dot3(column, to_mean);
    const Lane by_direction = (to_direction[j] - direction[j] * along) * inverse_distance;
    if (!is_parallel) out.mean[j] += by_direction;
    out.mean[j] = Select(seen, out.mean[j], Lane(0.0));
    const Lane to_place = Select(seen, is_parallel ? to_direction[j] : -by_direction, Lane(0.0));
    HWY_ALIGN float v[kLanes];
    hn::Store(to_place.v, d, v);
    for (int i = 0; i < available; ++i) {
      dshading[(is_parallel ? 3 : 0) + j] += static_cast<double>(v[i]);
    }
  }
  out.logit = OpacityGradient(s, g.response, g.is_linear, sums[slot::kH]);
  StoreGradients(out, s, seen, first, to.rows);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
