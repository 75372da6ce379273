// Footprints in double, one Gaussian at a time.
#include "gsut/projection/footprint_scalar.h"

#include <algorithm>
#include <cmath>

#include "gsut/gaussians/activations.h"
#include "gsut/projection/scalar_text.h"

namespace gsut {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

constexpr OneFootprint kNowhere = {kNaN, kNaN, kNaN, kNaN, kNaN,
                                   1.0,  -1.0, 1.0,  -1.0, FootprintStatus::kNothing};

}  // namespace

ScalarFootprints::ScalarFootprints(const Camera& camera, const Pose& camera_from_world,
                                   const FootprintOptions& options)
    : camera_(camera), pose_(camera_from_world), options_(options) {
  weights_ = MakeUnscentedWeights(options.unscented);
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
  const double cutoff = CutoffOf(gaussians, i, options_.rule);
  const PlacedGaussian<double> g = PlaceInDouble(gaussians, i, pose_);
  if (!(cutoff > 0.0) || !MayBeSeen(g, std::sqrt(cutoff))) return kNowhere;
  return FindPlaced(g, std::sqrt(cutoff));
}

// False where no pixel can see it.
bool ScalarFootprints::MayBeSeen(const PlacedGaussian<double>& g, double reach) const {
  const Eigen::Map<const Eigen::Vector3d> mean(g.mean);
  double g2 = 0.0;
  for (int k = 0; k < 3; ++k) {
    const double whitened = Eigen::Map<const Eigen::Vector3d>(g.axes[k]).dot(mean) / g.scale[k];
    g2 += whitened * whitened;
  }
  const double largest = *std::max_element(g.scale, g.scale + 3);
  if (!std::isfinite(g2) || !std::isfinite(largest)) return false;
  if (!camera_.IsCentral()) return true;
  // The cone around the sphere that holds the cut-off ellipsoid: all of it beyond the lens' domain?
  const double distance = mean.norm();
  const double sine = reach * largest / distance;
  const double angle = std::atan2(std::hypot(g.mean[0], g.mean[1]), g.mean[2]);
  return distance > 0.0 && !(sine < 1.0 && angle - std::asin(sine) > camera_.MaxAngle());
}

// Each method puts points into `points`, sends them through the lens, and reads its footprint off
// their pixels: EWA the mean and its derivative, the silhouette 64 or so points of the outline, the
// unscented transform seven. A footprint that is NaN has no simple outline: the search decides.
OneFootprint ScalarFootprints::FindPlaced(const PlacedGaussian<double>& g, double reach) const {
  using HWY_NAMESPACE::BoundedFootprint;
  double points[kOutlinePointsReference][3], pixels[kOutlinePointsReference][2];
  std::uint8_t valid[kOutlinePointsReference];
  const auto put = [&](int i, double x, double y, double z) {
    points[i][0] = x;
    points[i][1] = y;
    points[i][2] = z;
  };
  const auto get = [&](int i, double* u, double* v) {
    *u = pixels[i][0];
    *v = pixels[i][1];
  };
  const auto project = [&](int count) { camera_.Project(count, points[0], pixels[0], valid); };
  const LensDomain& domain = camera_.domain();
  const auto found = [&]() -> BoundedFootprint<double> {
    if (options_.method == ProjectionMethod::kEwa) {
      double derivatives[6];
      camera_.ProjectJacobian(1, g.mean, pixels[0], valid, derivatives, nullptr);
      return HWY_NAMESPACE::EwaFootprint(g, reach, pixels[0][0], pixels[0][1], derivatives,
                                         derivatives + 3);
    }
    if (options_.method == ProjectionMethod::kSilhouette) {
      BoundedFootprint<double> none = {};
      none.u = kNaN;
      if (!camera_.IsCentral()) return none;  // rays that touch the ellipsoid form no cone
      if (!HWY_NAMESPACE::PutOutline<kOutlinePointsReference>(domain, circle_, g, reach, put)) {
        return none;
      }
      project(kOutlinePointsReference);
      return HWY_NAMESPACE::OutlineFootprint<kOutlinePointsReference>(domain, circle_, reach, true,
                                                                      get);
    }
    HWY_NAMESPACE::PutUnscentedPoints(weights_, g.mean, g.axes, g.scale, put);
    project(HWY_NAMESPACE::kUnscentedPoints);
    return HWY_NAMESPACE::BoundUnscented(domain, weights_, reach, get);
  }();
  if (!std::isnan(found.u)) {
    return {found.u,     found.v,      found.cov_uu, found.cov_uv, found.cov_vv,
            found.low_u, found.high_u, found.low_v,  found.high_v, FootprintStatus::kBox};
  }
  OneFootprint out = kNowhere;
  out.status = FootprintStatus::kUnknown;
  if (options_.method == ProjectionMethod::kSilhouette) Search(g, reach, &out);
  return out;
}

// The exact box by the pixels' own rays, where there is no simple outline.
void ScalarFootprints::Search(const PlacedGaussian<double>& g, double reach,
                              OneFootprint* out) const {
  // The cone of rays that meet the ellipsoid, in whitened coordinates a cone around a ball.
  RayCone cone;
  for (int k = 0; k < 3; ++k) {
    cone.center[k] = 0.0;
    for (int row = 0; row < 3; ++row) {
      cone.whiten[k][row] = g.axes[k][row] / g.scale[k];
      cone.center[k] += cone.whiten[k][row] * g.mean[row];
    }
  }
  cone.cutoff = reach * reach;
  std::copy_n(g.mean, 3, cone.mean);
  cone.radius = reach * std::max({g.scale[0], g.scale[1], g.scale[2]});
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
