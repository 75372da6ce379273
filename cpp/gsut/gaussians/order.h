// The order in which the Gaussians of a pixel are blended.
#pragma once

#include <string>

namespace gsut {

// What orders the Gaussians of a camera, nearest first; equal keys by index.
//   kDistance  the mean's distance from the camera's centre, one order for all pixels;
//   kDepthZ    the mean's camera z, likewise;
//   kRay       where each pixel's own ray is nearest to the Gaussian, from the ray's own origin;
//   kIntegral  none: Gaussians are densities that overlap, see raster/reference/integral.h;
//   kModel     of a blend rule: as the Gaussians say, which say one of the first three.
enum class OrderKey { kDistance, kDepthZ, kRay, kIntegral, kModel };

// Throws InputError, with the known names, for any but "distance", "z", "ray", "integral" and
// "model".
OrderKey OrderNamed(const std::string& name);
const char* NameOf(OrderKey order);

}  // namespace gsut
