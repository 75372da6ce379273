// The rule by which a Gaussian's opacity and its response along a ray become an alpha.
#pragma once

#include <cmath>
#include <string>

namespace gsut {

// With o the opacity, D the smallest Mahalanobis distance along the ray and G = exp(-D^2 / 2):
//   kMaximum     alpha = o G.
//   kExtinction  alpha = 1 - (1 - o)^G: the optical depth -ln(1 - o) is spread as G is. The alpha
//                of the centre is the same, and coincident Gaussians add up as one.
//   kDensity     alpha = 1 - exp(ln(1 - o) G P(t / s) s / s0), a density's line integral from the
//                ray's origin: s the standard deviation along the ray, t the distance of the
//                nearest point, P the normal distribution, s0 the harmonic mean of the three
//                scales.
// All are alpha(strength x G): strength is o, or the optical depth -ln(1 - o).
// Sources: Kerbl et al. 2023 (maximum); Celarek et al. 2025, "Does 3D Gaussian splatting need
// accurate volumetric rendering?" (extinction as self-attenuation); Talegaonkar et al. 2025,
// "Volumetrically consistent 3D Gaussian rasterization" (density).
enum class Response { kMaximum, kExtinction, kDensity };

// Throws InputError, with the known names, for any but "maximum", "extinction" and "density".
Response ResponseNamed(const std::string& name);
const char* NameOf(Response response);

// alpha of raw = strength x G.
inline double AlphaOf(Response response, double raw) {
  return response == Response::kMaximum ? raw : -std::expm1(-raw);
}

// dalpha / draw.
inline double AlphaSlope(Response response, double alpha) {
  return response == Response::kMaximum ? 1.0 : 1.0 - alpha;
}

// The raw that gives alpha: the inverse of AlphaOf.
inline double RawOf(Response response, double alpha) {
  return response == Response::kMaximum ? alpha : -std::log1p(-alpha);
}

// log2 of RawOf as the float kernels count it. They measure optical depth in halvings of the light,
// -log2(1 - o), so that 2^-raw is what is left.
inline double Log2RawOf(Response response, double alpha) {
  constexpr double kLn2 = 0.69314718055994530942;
  const double raw = RawOf(response, alpha);
  return std::log2(response == Response::kMaximum ? raw : raw / kLn2);
}

}  // namespace gsut
