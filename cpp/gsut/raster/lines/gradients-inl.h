// From the sums V and K over a Gaussian's lines (line_backward-inl.h) to its parameters.
//
// With r = M (mean - nearest point) over k, dL/dM M^T = -cut-off K and M^T dL/d(M mean) =
// -k M^T V, both to D^2 as it is: the mean gets -k R S^-1 V, the logarithm of scale i cut-off K_ii,
// and a turn about the Gaussian's own axis z -cut-off K_xy (s_y / s_x - s_x / s_y), and so on. No
// difference of large numbers occurs, needles included.

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
  if (!LoadSlotSums(g, task.sh_rows, first, frame, to, &seen, sums)) return;
  const SeenLanes s = LoadSeen(g, first, view, task.log2_alpha_min, task.max_cutoff);
  const Lane k = Sqrt(s.cutoff);
  Lane g_mean[3];  // camera frame
  const Lane to_axes[3] = {k * sums[kSumV] / s.scale[0], k * sums[kSumV + 1] / s.scale[1],
                           k * sums[kSumV + 2] / s.scale[2]};
  for (int j = 0; j < 3; ++j) {
    g_mean[j] =
        -(s.axes[0][j] * to_axes[0] + s.axes[1][j] * to_axes[1] + s.axes[2][j] * to_axes[2]);
  }
  const Lane diagonal[3] = {sums[kSumK], sums[kSumK + 3], sums[kSumK + 5]};
  Lane g_scale[3];
  for (int j = 0; j < 3; ++j) g_scale[j] = Select(seen, s.cutoff * diagonal[j], Lane(0.0));
  const auto turn_about = [&](Lane off_diagonal, int i, int j) HWY_ATTR {
    return -(s.cutoff * off_diagonal * (s.scale[j] / s.scale[i] - s.scale[i] / s.scale[j]));
  };
  const Lane turn[3] = {turn_about(sums[kSumK + 4], 1, 2), turn_about(sums[kSumK + 2], 2, 0),
                        turn_about(sums[kSumK + 1], 0, 1)};
  // A turn w of a unit quaternion q about its own axes is q + q (0, w) / 2.
  const Lane two = Lane(2.0) * s.quat_scale;
  const Lane w = s.quat[0], x = s.quat[1], y = s.quat[2], z = s.quat[3];
  Lane g_quat[4] = {
      -(turn[0] * x + turn[1] * y + turn[2] * z), turn[0] * w - turn[1] * z + turn[2] * y,
      turn[1] * w - turn[2] * x + turn[0] * z, turn[2] * w - turn[0] * y + turn[1] * x};
  for (Lane& component : g_quat) component = Select(seen, two * component, Lane(0.0));

  Lane direction[3], g_direction[3];
  ShadingDirection(s, view, is_parallel, direction);
  ColorGradients(g, task.sh_rows, first, task.sh_degree, frame, seen, direction, &sums[kSumColor],
                 to, g_direction);
  const Lane along = Dot3(direction, g_direction);
  const Lane inverse_distance = Lane(1.0) / s.distance;
  Lane g_world[3];
  for (int j = 0; j < 3; ++j) {
    const Lane column[3] = {Lane(view.rotation[j]), Lane(view.rotation[3 + j]),
                            Lane(view.rotation[6 + j])};
    g_world[j] = Dot3(column, g_mean);
    const Lane by_direction = (g_direction[j] - direction[j] * along) * inverse_distance;
    if (!is_parallel) g_world[j] += by_direction;
    g_world[j] = Select(seen, g_world[j], Lane(0.0));
    const Lane to_place = Select(seen, is_parallel ? g_direction[j] : -by_direction, Lane(0.0));
    HWY_ALIGN float v[kLanes];
    hn::Store(to_place.v, d, v);
    for (int i = 0; i < available; ++i) {
      dshading[(is_parallel ? 3 : 0) + j] += static_cast<double>(v[i]);
    }
  }
  const Lane g_logit = Select(seen, sums[kSumH] * (Lane(1.0) - s.opacity), Lane(0.0));
  const GaussiansView<float>& out = to.rows;
  StoreRows3(g_world, available, out.means + 3 * first);
  StoreRows4(g_quat, available, out.quats + 4 * first);
  StoreRows3(g_scale, available, out.log_scales + 3 * first);
  StoreRows1(g_logit, available, out.opacity_logits + first);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
