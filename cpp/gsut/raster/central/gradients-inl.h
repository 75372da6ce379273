// From the gradients of a Gaussian's linear forms to those of its parameters and of the camera
// pose.
//
// With M = a (dL/da)^T + b (dL/db)^T + c (dL/dc)^T + (dL/dm) m^T in the camera frame, m the mean
// and q_i the Gaussian's axes (columns of Q):
//   dL/dm = a e1 + b e2 + c e3,  e1 = (k a.Gc - c.Ga) / |m|,  e2 = (k b.Gc - c.Gb) / |m|,
//           e3 = (2 kappa dL/dkappa + |m| dL/d(depth scale)) / |m|,   Ga = dL/da ...
//   dL/d(log scale i) = -q_i^T M q_i;  turning Q by w (left) gives w . axial(M^T);
//   turning the camera gives w . (a x Ga + b x Gb + c x Gc).
// The scales s and c.(mean direction) of a record change neither alpha nor depth, so they are
// constants here. No difference of large numbers occurs, needles included.

#if defined(GSUT_RASTER_CENTRAL_GRADIENTS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CENTRAL_GRADIENTS_INL_H_
#undef GSUT_RASTER_CENTRAL_GRADIENTS_INL_H_
#else
#define GSUT_RASTER_CENTRAL_GRADIENTS_INL_H_
#endif

#include "gsut/raster/central/records-inl.h"
#include "gsut/raster/slot_sums-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

HWY_INLINE void Cross(const Lane* a, const Lane* b, Lane* out) {
  out[0] += a[1] * b[2] - a[2] * b[1];
  out[1] += a[2] * b[0] - a[0] * b[2];
  out[2] += a[0] * b[1] - a[1] * b[0];
}

// Gradients of the Gaussians [first, first + kLanes) that exist; adds the pose's to dpose[6] if it
// is not null.
HWY_INLINE void GaussianGradients(const GaussiansView<const float>& g, const HarmonicsRows& sh_rows,
                                  std::int64_t first, const ViewFloats& view, float log2_alpha_min,
                                  float max_cutoff, int sh_degree, const Frame& frame,
                                  const GradientRows& to, double* dpose) {
  const FloatTag d;
  const std::int64_t available = HWY_MIN(g.size - first, static_cast<std::int64_t>(kLanes));
  LaneMask seen;
  Lane sums[16];
  if (!LoadSlotSums(g, sh_rows, first, frame, to, &seen, sums)) return;
  const SeenLanes s = LoadSeen(g, first, view, log2_alpha_min, max_cutoff);
  const RecordLanes r = MakeRecord(s);
  constexpr double kLn2 = 0.69314718055994530942;
  const Lane form_scale = Lane(2.0 * kLn2) * r.kappa;
  Lane ga[3], gb[3], gc[3];
  for (int k = 0; k < 3; ++k) {
    ga[k] = form_scale * sums[k];
    gb[k] = form_scale * sums[3 + k];
    gc[k] = -(form_scale * sums[6 + k]);
  }
  const Lane inverse_distance = Lane(1.0) / s.distance;
  const Lane e1 = (r.k * Dot3(r.a, gc) - Dot3(r.c, ga)) * inverse_distance;
  const Lane e2 = (r.k * Dot3(r.b, gc) - Dot3(r.c, gb)) * inverse_distance;
  const Lane e3 =
      Lane(2.0 * kLn2) * r.kappa * sums[slot::kHu] * inverse_distance + sums[slot::kDepth];
  Lane g_mean[3];  // camera frame, without the harmonics' part
  for (int k = 0; k < 3; ++k) g_mean[k] = r.a[k] * e1 + r.b[k] * e2 + r.c[k] * e3;
  // columns_of_mt[j] = M^T e_j ... kept as M[i][j].
  Lane m[3][3];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      m[i][j] = r.a[i] * ga[j] + r.b[i] * gb[j] + r.c[i] * gc[j] + g_mean[i] * s.mean[j];
    }
  }
  Lane g_scale[3];
  for (int k = 0; k < 3; ++k) {
    const Lane* q = s.axes[k];
    const Lane mq[3] = {Dot3(m[0], q), Dot3(m[1], q), Dot3(m[2], q)};
    g_scale[k] = Select(seen, -Dot3(q, mq), Lane(0.0));
  }
  // axial(P) with P = M^T, i.e. (P32 - P23, P13 - P31, P21 - P12), then into the world frame.
  const Lane axial[3] = {m[1][2] - m[2][1], m[2][0] - m[0][2], m[0][1] - m[1][0]};
  Lane turn[3], g_world[3];
  for (int k = 0; k < 3; ++k) {
    const Lane column[3] = {Lane(view.rotation[k]), Lane(view.rotation[3 + k]),
                            Lane(view.rotation[6 + k])};
    turn[k] = Dot3(column, axial);
    g_world[k] = Dot3(column, g_mean);
  }
  // A turn w of a unit quaternion q is q + (0, w) q / 2.
  const Lane two = Lane(2.0) * s.quat_scale;
  const Lane w = s.quat[0], x = s.quat[1], y = s.quat[2], z = s.quat[3];
  Lane g_quat[4] = {
      -(turn[0] * x + turn[1] * y + turn[2] * z), turn[0] * w + turn[1] * z - turn[2] * y,
      turn[1] * w + turn[2] * x - turn[0] * z, turn[2] * w + turn[0] * y - turn[1] * x};
  for (Lane& component : g_quat) component = Select(seen, two * component, Lane(0.0));

  // Colour.
  Lane direction[3];
  for (int k = 0; k < 3; ++k) direction[k] = s.world[k] * inverse_distance;
  Lane g_direction[3];
  ColorGradients(g, sh_rows, first, sh_degree, frame, seen, direction, &sums[slot::kColor], to,
                 g_direction);
  const Lane along = Dot3(direction, g_direction);
  for (int k = 0; k < 3; ++k) {
    g_world[k] += (g_direction[k] - direction[k] * along) * inverse_distance;
    g_world[k] = Select(seen, g_world[k], Lane(0.0));
  }
  const Lane g_logit = Select(seen, sums[slot::kH] * (Lane(1.0) - s.opacity), Lane(0.0));

  const GaussiansView<float>& out = to.rows;
  StoreRows3(g_world, available, out.means + 3 * first);
  StoreRows4(g_quat, available, out.quats + 4 * first);
  StoreRows3(g_scale, available, out.log_scales + 3 * first);
  StoreRows1(g_logit, available, out.opacity_logits + first);

  // Pose.
  if (dpose == nullptr) return;
  Lane g_turn[3] = {Lane(0.0), Lane(0.0), Lane(0.0)};
  Cross(r.a, ga, g_turn);
  Cross(r.b, gb, g_turn);
  Cross(r.c, gc, g_turn);
  for (int k = 0; k < 3; ++k) {
    const Lane row[3] = {Lane(view.rotation[3 * k]), Lane(view.rotation[3 * k + 1]),
                         Lane(view.rotation[3 * k + 2])};
    HWY_ALIGN float v[kLanes], t[kLanes];
    hn::Store(Dot3(row, g_world).v, d, v);
    hn::Store(Select(seen, g_turn[k], Lane(0.0)).v, d, t);
    for (int i = 0; i < available; ++i) {
      dpose[k] += static_cast<double>(v[i]);
      dpose[3 + k] += static_cast<double>(t[i]);
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
