// Footprints of Gaussians by three methods: linear, by sigma points, and the exact silhouette.
#pragma once

#include <cstdint>

#include "gsut/base/aligned_vector.h"
#include "gsut/cameras/camera.h"
#include "gsut/gaussians/gaussians.h"
#include "gsut/geometry/pose.h"
#include "gsut/projection/project.h"

namespace gsut {

// How a Gaussian's place, shape and bound in the image are found.
enum class ProjectionMethod : std::uint8_t {
  kEwa = 0,         // the lens' Jacobian at the mean (Zwicker et al., EWA Splatting, 2001)
  kUnscented = 1,   // 7 sigma points with alpha, beta, kappa (3DGUT)
  kSilhouette = 2,  // the cone of rays that touch the cut-off ellipsoid, through the lens: exact
};

struct FootprintOptions {
  ProjectionMethod method = ProjectionMethod::kUnscented;
  UnscentedOptions unscented;
  FootprintRule rule;
};

enum class FootprintStatus : std::uint8_t {
  kNothing = 0,  // no pixel sees it
  kBox = 1,      // the box is what the method says holds every pixel with alpha >= alpha_min
  kUnknown = 2,  // a point of the method has no pixel: it says nothing about this Gaussian
};

// One footprint a Gaussian, structure of arrays of `size` numbers. Of boxes, low > high where the
// status is not kBox. On a panorama a box may reach beyond the seam: it means its copies, too.
template <class T>
struct Footprints {
  std::int64_t size = 0;
  AlignedVector<T> u, v;                    // centre, pixels
  AlignedVector<T> cov_uu, cov_uv, cov_vv;  // pixels^2
  AlignedVector<T> low_u, high_u, low_v, high_v;
  AlignedVector<FootprintStatus> status;

  void Resize(std::int64_t n);
};

extern template struct Footprints<float>;
extern template struct Footprints<double>;

// The scalar double reference.
void FindFootprintsReference(const GaussiansView<const double>& gaussians, const Camera& camera,
                             const Pose& camera_from_world, const FootprintOptions& options,
                             Footprints<double>* footprints);

// Float path, vectorised and threaded. Boxes are kBoxRounding wider than the method says, so that
// rounding to float loses nothing. What has no simple outline (the camera inside, cut by the
// domain's edge, around a pole) is bounded by the scalar code; so is everything that silhouette
// finds through a lens whose rays do not meet.
void FindFootprints(const GaussiansView<const float>& gaussians, const Camera& camera,
                    const Pose& camera_from_world, const FootprintOptions& options,
                    Footprints<float>* footprints);

inline constexpr double kBoxRounding = 0.01;  // pixels: of float coordinates up to 65 536

}  // namespace gsut
