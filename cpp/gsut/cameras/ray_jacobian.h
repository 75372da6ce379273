// How the rays of pixels move when the lens' parameters change.
#pragma once

#include <cstdint>
#include <span>

#include "gsut/cameras/camera.h"

namespace gsut {

// Derivatives of Camera::UnprojectLines at fixed pixels by the lens' parameters: exact, by the
// implicit function theorem, from the derivatives of the projection. Both are across the ray: that
// a moving pupil also slides the origin along its ray, which changes no colour, is left out.
// rays (count, 3): unit rays of pixels; origins (count, 3): null for a central lens. chosen:
// indices of F parameters. drays, dorigins (count, 3, F): dorigins may be null. valid (count): 0,
// and zeros, where the ray has no image or the projection is singular.
void RayJacobian(const Camera& camera, std::int64_t count, const double* rays,
                 const double* origins, std::span<const int> chosen, double* drays,
                 double* dorigins, std::uint8_t* valid);

}  // namespace gsut
