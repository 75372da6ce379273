// Input checks that lenses share.
#include "gsut/cameras/lens_checks.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/cameras/lens_constants.h"

namespace gsut {
namespace {

// The name of one parameter: its word in the list, or "parameter 7" past the list's end.
std::string ParamName(const char* param_names, int index) {
  std::istringstream words(param_names);
  std::string word;
  for (int i = 0; words >> word; ++i) {
    if (i == index && word != "...") return word;
  }
  return "parameter " + std::to_string(index);
}

}  // namespace

void CheckFocalParams(const char* lens, const char* param_names, const double* params,
                      int num_params) {
  for (int i = 0; i < num_params; ++i) {
    const char* wanted = "finite";
    bool good = std::isfinite(params[i]);
    if (i < 2) {
      wanted = "positive and finite (a focal length in pixels)";
      good = good && params[i] > 0.0;
    } else if (i < 4) {
      wanted = "a pixel coordinate below 5e8";  // half of kMaxPixel
      good = good && std::abs(params[i]) <= 0.5 * kMaxPixel;
    }
    if (good) continue;
    std::ostringstream message;
    message << lens << ": " << ParamName(param_names, i) << " is " << params[i] << "; it must be "
            << wanted;
    throw InputError(message.str());
  }
}

// A radius in focal lengths that keeps pixels, with any principal point allowed, below kMaxPixel.
double LargestDistortedRadius(const double* params) {
  return 0.5 * kMaxPixel / std::max(params[0], params[1]);
}

// A round trip proves an inverse, whatever method found it. gain: how much an error of rounding in
// the ray grows on its way to the pixel.
bool InverseConverged(double u, double v, double back_u, double back_v, double gain) {
  // Rounding of the result, of the projection and of its sum with the principal point.
  constexpr double kUnitsInLastPlace = 16 * std::numeric_limits<double>::epsilon();
  const double size = std::max({std::abs(u), std::abs(v), gain});
  const double tolerance = std::max(kInverseTolerance, kUnitsInLastPlace * size);
  return std::hypot(back_u - u, back_v - v) < tolerance;
}

// To focal lengths about the principal point. NaN fails the comparison too.
bool FromPixel(const double* params, double u, double v, double* x, double* y) {
  if (!(std::abs(u) < kMaxPixel && std::abs(v) < kMaxPixel)) return false;
  *x = (u - params[2]) / params[0];
  *y = (v - params[3]) / params[1];
  return true;
}

}  // namespace gsut
