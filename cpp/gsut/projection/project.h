// Projects Gaussians through a lens with the unscented transform: centre, covariance, extent.
#pragma once

#include <cstdint>

#include "gsut/base/aligned_vector.h"
#include "gsut/cameras/camera.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/geometry/pose.h"

namespace gsut {

// Weights of the unscented transform (Wan and van der Merwe, 2000), 7 sigma points in 3D:
// lambda = alpha^2 (3 + kappa) - 3, points at the mean and at +-sqrt(3 + lambda) sigma along each
// axis. gsplat uses alpha = 0.1; gsut's default 1 keeps the points at sqrt(3) sigma, all weights
// positive or zero, and all digits in float.
struct UnscentedOptions {
  double alpha = 1.0;
  double beta = 2.0;
  double kappa = 0.0;
};

struct UnscentedWeights {
  double spread;          // sqrt(3 + lambda)
  double mean_0, mean_i;  // weights of the mean
  double cov_0;           // weight of the central point in the covariance; the others have mean_i
};

// Throws InputError unless alpha > 0, all are finite and 3 + lambda > 0.
UnscentedWeights MakeUnscentedWeights(const UnscentedOptions& options);

enum class SplatStatus : std::uint8_t {
  kUnseen = 0,     // surely no pixel sees it
  kSmall = 1,      // small and far: the ellipse, widened by BendMargin, surely holds the footprint
  kEllipse = 2,    // all sigma points have a pixel: the ellipse is the footprint's estimate
  kUncertain = 3,  // near the camera or across the domain's edge: no ellipse bounds it; the
                   // renderer finds its tiles by an exact test
};

// A Gaussian is small if its cut-off sphere is seen under less than this (Splats::sine) and lies
// within this share of the lens' largest angle (panoramas apart): towards a fold the lens bends too
// much. Its extents then err by less than BendMargin: to first order the lens is linear, and the
// second order moves a point of the silhouette by its distance (at most the larger extent) times
// that sine, in any direction. Worst seen over all lenses: 1.6 (images 400 wide), 1.94 (200 wide).
inline constexpr double kSmallSine = 0.1;
inline constexpr double kSmallAngle = 0.75;
inline constexpr double kSmallMargin = 3.0;

// Pixels by which the silhouette of a small Gaussian may exceed either extent of its splat.
template <class T>
inline T BendMargin(T sine, T extent_u, T extent_v) {
  return T(kSmallMargin) * sine * (extent_u > extent_v ? extent_u : extent_v);
}

// One splat a Gaussian, structure of arrays of `size` floats. Unless the status is kEllipse the
// pixel quantities are NaN where sigma points are missing; they are never averaged from the rest.
struct Splats {
  std::int64_t size = 0;
  AlignedVector<float> u, v;                    // centre, pixels
  AlignedVector<float> cov_uu, cov_uv, cov_vv;  // pixels^2
  AlignedVector<float> extent_u, extent_v;  // half width and height that hold alpha >= alpha_min
  AlignedVector<float> distance;            // of the mean from the camera centre
  // Of the half angle of the cut-off sphere, over the angle within which the lens is smooth (to the
  // edge of its domain or a panorama's pole, at most 1); at most 1.
  AlignedVector<float> sine;
  AlignedVector<SplatStatus> status;

  void Resize(std::int64_t n);
};

// The cut-off that extents and visibility refer to.
struct FootprintRule {
  double alpha_min = 1.0 / 255.0;
  double response_min = 0.0;  // as BlendRule::response_min
};

// Float path, vectorised and threaded. Needs no pixel test: a splat outside the image is kUnseen.
// Error of the centre against the double reference: below 1e-4 px for alpha >= 0.1 (tested).
void Project(const GaussiansView<const float>& gaussians, const Camera& camera,
             const Pose& camera_from_world, const UnscentedOptions& options,
             const FootprintRule& rule, Splats* splats);

// The scalar double reference: means (N, 2), covariances (N, 2, 2), sigma points valid (N).
void ProjectReference(const GaussiansView<const double>& gaussians, const Camera& camera,
                      const Pose& camera_from_world, const UnscentedOptions& options, double* means,
                      double* covariances, std::uint8_t* valid);

// The same by the lens' derivative J at the mean, cov = J R S S^T R^T J^T (Zwicker et al., EWA
// Splatting, 2001): a baseline, exact for a linear lens only. valid (N): the mean has a pixel.
void ProjectEwaReference(const GaussiansView<const double>& gaussians, const Camera& camera,
                         const Pose& camera_from_world, double* means, double* covariances,
                         std::uint8_t* valid);

// D^2 at which a primitive of this strength is cut off; <= 0 if it is never drawn.
double CutoffOf(double strength, Response response, const FootprintRule& rule,
                const Profile& profile = {});
template <class T>
double CutoffOf(const GaussiansView<T>& gaussians, std::int64_t i, const FootprintRule& rule) {
  return CutoffOf(gaussians.Strength(i), gaussians.response, rule, Profile{gaussians.primitive});
}

}  // namespace gsut
