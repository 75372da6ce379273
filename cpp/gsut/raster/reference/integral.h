// The light along one ray through Gaussians that overlap: no order, and no approximation.
//
// Gaussian i is a density along the ray, A_i phi((t - t_i) / s_i) / s_i with A_i = -ln(1 - alpha_i)
// its optical depth along the whole line and phi the normal density; t > 0 counts. With P the
// normal distribution the light left at t is
//   T(t) = exp(-sum_j A_j (P((t - t_j) / s_j) - P(-t_j / s_j))),
// and the share of the pixel that Gaussian i makes up is the integral of density_i T.
#pragma once

#include <cmath>
#include <vector>

#include "gsut/raster/reference/blend_ray.h"

namespace gsut {

inline double NormalCdf(double x) {
  constexpr double kInverseRoot2 = 0.70710678118654752440;
  return 0.5 * std::erfc(-kInverseRoot2 * x);
}

inline double NormalDensity(double x) {
  constexpr double kInverseRoot2Pi = 0.39894228040143267794;
  return kInverseRoot2Pi * std::exp(-0.5 * x * x);
}

// Fills hits, by t of their means: their weights, within 1e-12 in sum, and as t the mean distance
// of what they show. Returns the final transmittance, which is closed form. Of the rule only
// alpha_max counts: nothing is too faint, nor hidden by a limit.
double Integrate(const std::vector<Seen>& seen, const Ray& ray, const BlendRule& rule,
                 Response response, std::vector<Hit>* hits);

}  // namespace gsut
