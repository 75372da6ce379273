// Footprints in double, one Gaussian at a time.
#include "gsut/projection/footprint_scalar.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>

#include "gsut/cameras/lens_registry.h"
#include "gsut/cameras/scalar_math.h"
#include "gsut/gaussians/activations.h"
#include "gsut/projection/project_kernels.h"

// The scalar names that the methods' text uses; before its text.
#include <hwy/highway.h>
namespace gsut::HWY_NAMESPACE {
using lenses::Abs;
using lenses::AndMask;
using lenses::Max;
using lenses::Min;
using lenses::OrMask;
using lenses::Select;
using lenses::Sqrt;
}  // namespace gsut::HWY_NAMESPACE
#include "gsut/projection/footprint-inl.h"

namespace gsut {

using PlacedDouble = HWY_NAMESPACE::PlacedGaussian<double>;

struct ScalarFootprints::Placed : PlacedDouble {};

namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Found = HWY_NAMESPACE::PlacedFootprint<double, bool>;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

constexpr OneFootprint kNowhere = {kNaN, kNaN, kNaN, kNaN, kNaN,
                                   1.0,  -1.0, 1.0,  -1.0, FootprintStatus::kNothing};

template <class Lens>
Found Ewa(const Camera& camera, const PlacedDouble& g) {
  using D = Dual<3>;
  const int num_params = camera.num_params();
  if constexpr (requires { Lens::kHasTable; }) {
    return HWY_NAMESPACE::EwaFootprint<Lens, D, double>(camera.domain(), camera.params().data(),
                                                        num_params, g);
  } else {
    std::array<D, kMaxLensParams> constants;
    for (int k = 0; k < num_params; ++k)
      constants[static_cast<std::size_t>(k)] = D(camera.params()[static_cast<std::size_t>(k)]);
    return HWY_NAMESPACE::EwaFootprint<Lens, D, double>(camera.domain(), constants.data(),
                                                        num_params, g);
  }
}

}  // namespace

ScalarFootprints::ScalarFootprints(const Camera& camera, const Pose& camera_from_world,
                                   const FootprintOptions& options)
    : camera_(camera), pose_(camera_from_world), options_(options) {
  rule_ = MakeSigmaRule(options.method, options.unscented);
  if (options.method == ProjectionMethod::kSilhouette) pyramid_ = PyramidOf(camera);
  for (int k = 0; k < kOutlinePointsReference; ++k) {
    circle_[k][0] = std::cos(2.0 * kPi * k / kOutlinePointsReference);
    circle_[k][1] = std::sin(2.0 * kPi * k / kOutlinePointsReference);
  }
}

OneFootprint ScalarFootprints::Find(const GaussiansView<const float>& gaussians,
                                    std::int64_t i) const {
  return FindAs(gaussians, i);
}

OneFootprint ScalarFootprints::Find(const GaussiansView<const double>& gaussians,
                                    std::int64_t i) const {
  return FindAs(gaussians, i);
}

template <class T>
OneFootprint ScalarFootprints::FindAs(const GaussiansView<const T>& gaussians,
                                      std::int64_t i) const {
  Placed g;
  return Place(gaussians, i, &g) ? FindPlaced(g) : kNowhere;
}

// False where no pixel can see it.
template <class T>
bool ScalarFootprints::Place(const GaussiansView<const T>& gaussians, std::int64_t i,
                             Placed* g) const {
  const Vector3d mean =
      pose_.rotation * Eigen::Map<const Eigen::Matrix<T, 3, 1>>(gaussians.means + 3 * i)
                           .template cast<double>() +
      pose_.translation;
  double quat[4], r[9];
  for (int k = 0; k < 4; ++k) quat[k] = static_cast<double>(gaussians.quats[4 * i + k]);
  RotationFromQuaternion(quat, r);
  const Matrix3d q =
      pose_.rotation * Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r);
  const double opacity = Sigmoid(static_cast<double>(gaussians.opacity_logits[i]));
  const double cutoff = CutoffOf(opacity, options_.rule);
  if (!(cutoff > 0.0)) return false;
  g->reach = std::sqrt(cutoff);
  double g2 = 0.0, largest = 0.0;
  for (int k = 0; k < 3; ++k) {
    g->mean[k] = mean[k];
    g->scale[k] = ScaleFromLog(static_cast<double>(gaussians.log_scales[3 * i + k]));
    for (int row = 0; row < 3; ++row) g->axes[k][row] = q(row, k);
    const double whitened = q.col(k).dot(mean) / g->scale[k];
    g2 += whitened * whitened;
    largest = std::max(largest, g->scale[k]);
  }
  if (!camera_.IsCentral()) return std::isfinite(g2) && std::isfinite(largest);
  const double distance = mean.norm();
  if (!std::isfinite(g2) || !std::isfinite(largest) || !(distance > 0.0)) return false;
  const double sine = g->reach * largest / distance;
  const double angle = std::atan2(std::hypot(mean[0], mean[1]), mean[2]);
  return !(sine < 1.0 && angle - std::asin(sine) > camera_.MaxAngle());
}

OneFootprint ScalarFootprints::FindPlaced(const Placed& g) const {
  const ProjectionMethod method = options_.method;
  const LensDomain& domain = camera_.domain();
  const double* params = camera_.params().data();
  const int num_params = camera_.num_params();
  const Found found = VisitLens(camera_.lens(), [&](auto lens) -> Found {
    using Lens = decltype(lens);
    const HWY_NAMESPACE::ImagePeriod period = HWY_NAMESPACE::PeriodOf<Lens>(domain, params);
    if (method == ProjectionMethod::kEwa) return Ewa<Lens>(camera_, g);
    if (method == ProjectionMethod::kSilhouette) {
      if constexpr (requires { Lens::kHasOrigins; }) return Found{};  // rays touch along no cone
      return HWY_NAMESPACE::SilhouetteFootprint<Lens, kOutlinePointsReference, double>(
          domain, params, num_params, period, circle_, g);
    }
    return HWY_NAMESPACE::SigmaFootprint<Lens, double>(domain, params, num_params, period, rule_,
                                                       g);
  });
  if (found.valid) {
    return {found.u,     found.v,      found.cov_uu, found.cov_uv, found.cov_vv,
            found.low_u, found.high_u, found.low_v,  found.high_v, FootprintStatus::kBox};
  }
  OneFootprint out = kNowhere;
  out.status = FootprintStatus::kUnknown;
  if (method == ProjectionMethod::kSilhouette) Search(g, &out);
  return out;
}

// The exact box by the pixels' own rays, where there is no simple outline.
void ScalarFootprints::Search(const Placed& g, OneFootprint* out) const {
  RayCone cone;
  for (int k = 0; k < 3; ++k) {
    cone.center[k] = 0.0;
    for (int row = 0; row < 3; ++row) {
      cone.whiten[k][row] = g.axes[k][row] / g.scale[k];
      cone.center[k] += cone.whiten[k][row] * g.mean[row];
    }
  }
  cone.cutoff = g.reach * g.reach;
  std::copy_n(g.mean, 3, cone.mean);
  cone.radius = g.reach * std::max({g.scale[0], g.scale[1], g.scale[2]});
  double box[4];
  if (!pyramid_->Box(camera_.Rays(), cone, box)) {
    out->status = FootprintStatus::kNothing;
    return;
  }
  out->status = FootprintStatus::kBox;
  out->low_u = box[0];
  out->high_u = box[1];
  out->low_v = box[2];
  out->high_v = box[3];
}

}  // namespace gsut
