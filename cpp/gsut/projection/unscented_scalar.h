// The unscented transform in double, many Gaussians at a time.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include <hwy/highway.h>

#include "gsut/cameras/scalar_math.h"
#include "gsut/projection/placed_gaussian.h"

// The text of unscented-inl.h for double: the name that it uses, then itself.
namespace gsut::HWY_NAMESPACE {
using lenses::Select;
}  // namespace gsut::HWY_NAMESPACE
#include "gsut/projection/unscented-inl.h"

namespace gsut {

using ScalarFootprint = HWY_NAMESPACE::Footprint<double>;

// Gaussians whose points go through the lens together.
inline constexpr std::int64_t kScalarBatch = 64;

// Calls use(i, footprint) for the Gaussians [begin, end). through(first, count, points, pixels)
// gives the pixels (count, 2) of the points (count, 3) of the Gaussians from `first` on, NaN where
// there is none; every Gaussian has kUnscentedPoints, in the frame that `pose` leads to.
template <class T, class Through, class Use>
void UnscentedInDouble(const GaussiansView<const T>& gaussians, const Pose& pose,
                       const LensDomain& domain, const UnscentedWeights& weights,
                       std::int64_t begin, std::int64_t end, Through&& through, Use&& use) {
  constexpr int kPoints = HWY_NAMESPACE::kUnscentedPoints;
  std::vector<double> points(3 * kPoints * kScalarBatch), pixels(2 * kPoints * kScalarBatch);
  for (std::int64_t first = begin; first < end; first += kScalarBatch) {
    const std::int64_t count = std::min(end - first, kScalarBatch);
    for (std::int64_t j = 0; j < count; ++j) {
      const PlacedGaussian<double> g = PlaceInDouble(gaussians, first + j, pose);
      HWY_NAMESPACE::PutUnscentedPoints(weights, g.mean, g.axes, g.scale,
                                        [&](int k, double x, double y, double z) {
                                          double* point = &points[3 * (j * kPoints + k)];
                                          point[0] = x;
                                          point[1] = y;
                                          point[2] = z;
                                        });
    }
    through(first, kPoints * count, points.data(), pixels.data());
    for (std::int64_t j = 0; j < count; ++j) {
      use(first + j, HWY_NAMESPACE::UnscentedFootprint<double>(
                         domain, weights, [&](int k, double* u, double* v) {
                           *u = pixels[2 * (j * kPoints + k)];
                           *v = pixels[2 * (j * kPoints + k) + 1];
                         }));
    }
  }
}

// Writes row i of means (N, 2), covariances (N, 2, 2) and valid (N); NaN where a point is invalid.
inline void WriteFootprint(const ScalarFootprint& footprint, std::int64_t i, double* means,
                           double* covariances, std::uint8_t* valid) {
  const bool ok = !std::isnan(footprint.u);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  valid[i] = ok;
  means[2 * i] = ok ? footprint.u : nan;
  means[2 * i + 1] = ok ? footprint.v : nan;
  covariances[4 * i] = ok ? footprint.cov_uu : nan;
  covariances[4 * i + 1] = covariances[4 * i + 2] = ok ? footprint.cov_uv : nan;
  covariances[4 * i + 3] = ok ? footprint.cov_vv : nan;
}

}  // namespace gsut
