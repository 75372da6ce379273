// Domain and checks of lenses that are symmetric about the axis, or see every direction.
#pragma once

#include <functional>

namespace gsut {

struct LensDomain;

// Throws InputError unless low <= value <= high.
void CheckLensParam(const char* lens, const char* name, double value, double low, double high);

// max_angle = angle, and limits[3] as families/cone.h wants it: the tangent of half of it, or
// infinity for pi.
void SetCone(double angle, LensDomain* domain);

// radius(angle): distorted radius in focal lengths, increasing on (0, angle); beyond a pole it may
// be anything that is negative, not finite or huge. The domain ends at `angle`, at angle_limit, or
// where pixels come near kMaxPixel. Sets max_angle, max_radius and limits[3].
LensDomain RadialDomain(const double* params, double angle, double angle_limit,
                        const std::function<double(double angle)>& radius);

// The direction (x, y, z), of any length but 0, as a unit ray; false if it lies outside the cone of
// the domain (limits[3]).
bool RayInCone(const LensDomain& domain, double x, double y, double z, double* ray);

}  // namespace gsut
