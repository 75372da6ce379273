// What the double reference's two passes share: the Gaussians of a view in order, and their blend
// along one ray.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "gsut/gaussians/gaussians.h"
#include "gsut/raster/blend_rule.h"
#include "gsut/raster/view_rays.h"

namespace gsut {

// A Gaussian seen from one camera.
struct Seen {
  std::int64_t index = 0;
  float key = 0;              // order; rounded to float as the tiled path does
  Eigen::Matrix3d whiten;     // A = S^-1 R^T, world to whitened
  Eigen::Vector3d relative;   // m = mean - reference's centre
  Eigen::Vector3d whitened;   // A m
  Eigen::Vector3d direction;  // shaded by: from the reference to the mean, or its axis
  double opacity = 0;
  Eigen::Vector3d color;
  bool clamped[3] = {false, false, false};
};

// One blended Gaussian of a pixel.
struct Hit {
  std::size_t seen;
  double alpha, response, weight, t;
  bool clamped;
};

// Coefficients of the harmonics that are used, of those that are stored.
int UsedCoefficients(int sh_coefficients, int sh_degree);

// All Gaussians that can be drawn, nearest first. Throws InputError if a parameter is not finite.
std::vector<Seen> SortedGaussians(const GaussiansView<const double>& g, const ViewRays& view,
                                  const RenderSettings& settings);

// A pixel's ray in world axes, its origin relative to the reference's centre.
struct Ray {
  Eigen::Vector3d origin, direction;
};

Ray RayOf(const ViewRays& view, std::size_t pixel);

// Blends all Gaussians along one ray; fills hits and returns the final transmittance.
double Blend(const std::vector<Seen>& seen, const Ray& ray, const BlendRule& rule,
             std::vector<Hit>* hits);

// Coverage and mean distance of a pixel, which its distortion is about.
struct MeanDistance {
  double alpha = 0, mean = 0;

  explicit MeanDistance(const std::vector<Hit>& hits) {
    for (const Hit& hit : hits) {
      alpha += hit.weight;
      mean += hit.weight * hit.t;
    }
    if (alpha > 0.0) mean /= alpha;
  }
  bool Counts() const { return alpha >= kDistortionAlpha; }
};

}  // namespace gsut
