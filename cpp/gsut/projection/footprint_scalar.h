// The footprint of one Gaussian in double, by each method; the kernels' exceptions come here, too.
#pragma once

#include <limits>
#include <memory>

#include "gsut/projection/footprint.h"
#include "gsut/projection/footprint_kernels.h"
#include "gsut/projection/placed_gaussian.h"
#include "gsut/projection/ray_pyramid.h"

namespace gsut {

struct OneFootprint {
  double u, v, cov_uu, cov_uv, cov_vv;
  double low_u, high_u, low_v, high_v;
  FootprintStatus status;
};

// The scalar methods on one camera, which must outlive the object.
class ScalarFootprints {
 public:
  ScalarFootprints(const Camera& camera, const Pose& camera_from_world,
                   const FootprintOptions& options);

  OneFootprint Find(const GaussiansView<const float>& gaussians, std::int64_t i) const;
  OneFootprint Find(const GaussiansView<const double>& gaussians, std::int64_t i) const;

 private:
  template <class T>
  OneFootprint FindAs(const GaussiansView<const T>& gaussians, std::int64_t i) const;
  bool MayBeSeen(const PlacedGaussian<double>& g, double reach) const;
  OneFootprint FindPlaced(const PlacedGaussian<double>& g, double reach) const;
  void Search(const PlacedGaussian<double>& g, double reach, OneFootprint* out) const;

  const Camera& camera_;
  const Pose& pose_;
  const FootprintOptions options_;
  UnscentedWeights weights_;
  std::shared_ptr<const RayPyramid> pyramid_;
  double circle_[kOutlinePointsReference][2];
};

// Writes one row, its box wider by `rounding`.
template <class T>
void StoreFootprint(const OneFootprint& one, double rounding, std::size_t j, Footprints<T>* out) {
  out->u[j] = static_cast<T>(one.u);
  out->v[j] = static_cast<T>(one.v);
  out->cov_uu[j] = static_cast<T>(one.cov_uu);
  out->cov_uv[j] = static_cast<T>(one.cov_uv);
  out->cov_vv[j] = static_cast<T>(one.cov_vv);
  const double wider = one.status == FootprintStatus::kBox ? rounding : 0.0;
  out->low_u[j] = static_cast<T>(one.low_u - wider);
  out->high_u[j] = static_cast<T>(one.high_u + wider);
  out->low_v[j] = static_cast<T>(one.low_v - wider);
  out->high_v[j] = static_cast<T>(one.high_v + wider);
  out->status[j] = one.status;
}

}  // namespace gsut
