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

// Adds a x b to out.
HWY_INLINE void AddCross(const Lane* a, const Lane* b, Lane* out) {
  out[0] += a[1] * b[2] - a[2] * b[1];
  out[1] += a[2] * b[0] - a[0] * b[2];
  out[2] += a[0] * b[1] - a[1] * b[0];
}

// Gradients to the linear forms of a batch, camera frame: what the sums lack, see backward-inl.h.
struct FormGradients {
  Lane a[3], b[3], c[3];

  HWY_INLINE FormGradients(Lane kappa, const Lane* sums) {
    constexpr double kTwoLn2 = 1.38629436111989061883;
    const Lane scale = Lane(kTwoLn2) * kappa;
    for (int k = 0; k < 3; ++k) {
      a[k] = scale * sums[record::kA + k];
      b[k] = scale * sums[record::kB + k];
      c[k] = -(scale * sums[record::kC + k]);
    }
  }
};

// dL/dm in the camera frame, without what shading adds.
HWY_INLINE void MeanGradient(const RecordLanes& r, const FormGradients& to, const Lane* sums,
                             Lane inverse_distance, Lane* to_mean) {
  constexpr double kTwoLn2 = 1.38629436111989061883;
  const Lane e1 = (r.k * Dot3(r.a, to.c) - Dot3(r.c, to.a)) * inverse_distance;
  const Lane e2 = (r.k * Dot3(r.b, to.c) - Dot3(r.c, to.b)) * inverse_distance;
  const Lane e3 = Lane(kTwoLn2) * r.kappa * sums[slot::kHu] * inverse_distance + sums[slot::kDepth];
  for (int k = 0; k < 3; ++k) to_mean[k] = r.a[k] * e1 + r.b[k] * e2 + r.c[k] * e3;
}

// Adds the pose's gradient to dpose[6]: the sum of the means' for the translation, of the turns' of
// a, b and c for the rotation.
HWY_INLINE void AddPoseGradient(const RecordLanes& r, const FormGradients& to, const Lane* to_world,
                                const ViewFloats& view, LaneMask seen, std::int64_t available,
                                double* dpose) {
  const FloatTag d;
  Lane to_turn[3] = {Lane(0.0), Lane(0.0), Lane(0.0)};
  AddCross(r.a, to.a, to_turn);
  AddCross(r.b, to.b, to_turn);
  AddCross(r.c, to.c, to_turn);
  for (int k = 0; k < 3; ++k) {
    const Lane row[3] = {Lane(view.rotation[3 * k]), Lane(view.rotation[3 * k + 1]),
                         Lane(view.rotation[3 * k + 2])};
    HWY_ALIGN float v[kLanes], t[kLanes];
    hn::Store(Dot3(row, to_world).v, d, v);
    hn::Store(Select(seen, to_turn[k], Lane(0.0)).v, d, t);
    for (int i = 0; i < available; ++i) {
      dpose[k] += static_cast<double>(v[i]);
      dpose[3 + k] += static_cast<double>(t[i]);
    }
  }
}

// Gradients of the Gaussians [first, first + kLanes) that exist; adds the pose's to dpose[6] if it
// is not null.
HWY_INLINE void GaussianGradients(const RasterTask& task, std::int64_t first, const Frame& frame,
                                  const GradientRows& to, double* dpose) {
  const GaussiansView<const float>& g = task.gaussians;
  const ViewFloats& view = task.view;
  LaneMask seen;
  Lane sums[16];
  if (!LoadSlotSums(g, first, frame, to, &seen, sums)) return;
  const SeenLanes s = LoadSeen(g, first, view, task.log2_raw_min, task.max_cutoff);
  const RecordLanes r = MakeRecord(s);
  const FormGradients forms(r.kappa, sums);
  const Lane inverse_distance = Lane(1.0) / s.distance;
  Lane to_mean[3];  // camera frame
  MeanGradient(r, forms, sums, inverse_distance, to_mean);
  Lane m[3][3];
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      m[i][j] =
          r.a[i] * forms.a[j] + r.b[i] * forms.b[j] + r.c[i] * forms.c[j] + to_mean[i] * s.mean[j];
    }
  }
  ParameterGradients out;
  for (int k = 0; k < 3; ++k) {
    const Lane* q = s.axes[k];
    const Lane mq[3] = {Dot3(m[0], q), Dot3(m[1], q), Dot3(m[2], q)};
    out.log_scale[k] = -Dot3(q, mq);
  }
  // axial(P) with P = M^T, i.e. (P32 - P23, P13 - P31, P21 - P12), then into the world frame.
  const Lane axial[3] = {m[1][2] - m[2][1], m[2][0] - m[0][2], m[0][1] - m[1][0]};
  Lane turn[3];
  for (int k = 0; k < 3; ++k) {
    const Lane column[3] = {Lane(view.rotation[k]), Lane(view.rotation[3 + k]),
                            Lane(view.rotation[6 + k])};
    turn[k] = Dot3(column, axial);
    out.mean[k] = Dot3(column, to_mean);
  }
  TurnFromLeft(s, turn, out.quat);
  Lane direction[3], to_direction[3];
  for (int k = 0; k < 3; ++k) direction[k] = s.world[k] * inverse_distance;
  ColorGradients(g, first, task.sh_degree, frame, seen, direction, &sums[slot::kColor], to,
                 to_direction);
  const Lane along = Dot3(direction, to_direction);
  for (int k = 0; k < 3; ++k) {
    out.mean[k] += (to_direction[k] - direction[k] * along) * inverse_distance;
    out.mean[k] = Select(seen, out.mean[k], Lane(0.0));
  }
  out.logit = OpacityGradient(s, g.response, g.is_linear, sums[slot::kH]);
  StoreGradients(out, s, seen, first, to.rows);
  if (dpose == nullptr) return;
  const std::int64_t available = HWY_MIN(g.size - first, static_cast<std::int64_t>(kLanes));
  AddPoseGradient(r, forms, out.mean, view, seen, available, dpose);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
