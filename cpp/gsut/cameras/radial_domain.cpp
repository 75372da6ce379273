// Domain and checks of lenses that are symmetric about the axis, or see every direction.
#include "gsut/cameras/radial_domain.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include "gsut/base/errors.h"
#include "gsut/cameras/visit_lens.h"

namespace gsut {

void CheckLensParam(const char* lens, const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return;
  std::ostringstream message;
  message << lens << ": " << name << " is " << value << "; it must be between " << low << " and "
          << high;
  throw InputError(message.str());
}

// limits[3] is tan of half the angle, by which kernels test for the cone without an arctangent.
void SetCone(double angle, LensDomain* domain) {
  domain->max_angle = angle;
  domain->limits[3] = angle < kPi ? std::tan(0.5 * angle) : kInfinity;
}

// The radius rises with the angle up to `angle`; bisection finds where it leaves the largest pixel.
LensDomain RadialDomain(const double* params, double angle, double angle_limit,
                        const std::function<double(double angle)>& radius) {
  const double largest = LargestDistortedRadius(params);
  const auto has_image = [&](double at) {
    const double r = radius(at);
    return r >= 0.0 && r <= largest;
  };
  double end = std::min({angle, angle_limit, kPi});
  if (!has_image(end)) {
    double low = 0.0, high = end;
    for (;;) {
      const double middle = 0.5 * (low + high);
      if (!(middle > low && middle < high)) break;
      (has_image(middle) ? low : high) = middle;
    }
    end = low;
  }
  LensDomain domain;
  SetCone(end, &domain);
  domain.max_radius = radius(end);
  return domain;
}

// Beyond 90 degrees the cone is the complement of one behind: the two tests differ there.
bool RayInCone(const LensDomain& domain, double x, double y, double z, double* ray) {
  const double h = std::hypot(x, y);
  const double n = std::hypot(h, z);
  if (!(n > 0.0 && n < kInfinity)) return false;
  const bool inside = domain.max_angle < kPi ? lenses::Cone::Contains(domain, h, z, n)
                                             : lenses::Cone::ContainsOrBehind(domain, h, z, n);
  if (!inside) return false;
  ray[0] = x / n;
  ray[1] = y / n;
  ray[2] = z / n;
  return true;
}

}  // namespace gsut
