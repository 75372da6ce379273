// Orders the Gaussians of a view and blends them along one ray, for the double reference.
#pragma once

#include <Eigen/Core>
#include <cmath>
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
  double strength = 0;
  double mean_scale = 0;  // harmonic mean of the scales
  Profile profile;
  Eigen::Vector3d color;
  bool clamped[3] = {false, false, false};
};

// One blended Gaussian of a pixel.
struct Hit {
  std::size_t seen;
  double alpha;
  double response;  // what the strength is multiplied by
  double weight, t;
  bool clamped;
};

// A pixel's ray in world axes, its origin relative to the reference's centre.
struct Ray {
  Eigen::Vector3d origin, direction;
};

// Where a ray passes a Gaussian: with w = A d and v = A (m - o), D^2 = |v - t w|^2 is least at
// t = v.w / |w|^2. For triangles see HitPlane.
struct Passing {
  Eigen::Vector3d w, v;
  double t, w2;  // w2 = |w|^2
  double d2;     // |v - t w|^2; of a triangle the gauge's square
  double peak;   // the response, of a Gaussian exp(-d2 / 2)
  // Derivatives by v: of d2 / 2, and of t. Those by w are -t pull, and t_by_w.
  Eigen::Vector3d pull, t_by_v, t_by_w;

  Passing(const Seen& s, const Ray& ray)
      : w(s.whiten * ray.direction), v(s.whitened - s.whiten * ray.origin) {
    w2 = w.squaredNorm();
    if (s.profile.IsGaussian()) {
      t = v.dot(w) / w2;
      pull = v - t * w;  // across w
      d2 = pull.squaredNorm();
      t_by_v = w / w2;
      t_by_w = (v - 2.0 * t * w) / w2;
    } else {
      HitPlane(s.profile);
    }
    peak = s.profile.Response(d2);
  }
  // The standard deviation along the ray, in units of t.
  double Width() const { return 1.0 / std::sqrt(w2); }

 private:
  // A triangle is hit in its plane, where v - t w has no third component, and a gauge of the other
  // two takes the place of D. The gauge is of the hit seen from the mean, t w - v, and t = v_z /
  // w_z carries the hit along.
  void HitPlane(const Profile& profile) {
    t = v.z() / w.z();
    double slopes[2];
    const double gauge = profile.Gauge(t * w.x() - v.x(), t * w.y() - v.y(), slopes);
    d2 = gauge * gauge;
    pull << -slopes[0], -slopes[1], (slopes[0] * w.x() + slopes[1] * w.y()) / w.z();
    pull *= gauge;
    t_by_v << 0.0, 0.0, 1.0 / w.z();
    t_by_w = -t * t_by_v;
  }
};

// What the strength of a Gaussian is multiplied by along a ray that is infinite in both directions.
double ResponseOfLine(const Seen& s, const Ray& ray, const Passing& at, Response response);

// Coefficients of the harmonics that are used, of those that are stored.
int UsedCoefficients(int sh_coefficients, int sh_degree);

// All Gaussians that can be drawn, nearest first. Throws InputError if a parameter is not finite.
std::vector<Seen> SortedGaussians(const GaussiansView<const double>& g, const ViewRays& view,
                                  const RenderSettings& settings);

Ray RayOf(const ViewRays& view, std::size_t pixel);

// Blends all Gaussians along one ray; fills hits and returns the final transmittance.
double Blend(const std::vector<Seen>& seen, const Ray& ray, const BlendRule& rule,
             Response response, std::vector<Hit>* hits);

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
