// What a lens must hold. One lens = one file under cameras/models; the build finds it.
//
// A lens file is read several times, in different namespaces: once for scalars (double, Dual) by
// lens_registry.h, and once per instruction set by the vector kernels of gsut/projection. It
// therefore has no include guard, no #include and no namespace, and holds one struct, named like the
// file in PascalCase, that uses only the names below, unqualified:
//
//   struct KannalaBrandt {
//     static constexpr const char* kName = "kannala_brandt";
//     // True if a parameter vector of this length is a lens.
//     static bool AcceptsParams(int num_params);
//     // "fx fy cx cy k1 k2 ...", for messages and documentation.
//     static const char* ParamNames();
//     // The one-to-one domain connected to the axis, found once on load, in double.
//     // Throws InputError if the parameters describe no lens (focal length <= 0, not finite ...).
//     static LensDomain MakeDomain(const double* params, int num_params);
//     // Pixel of a point in the camera frame (x right, y down, z forward; any length but 0).
//     // Returns whether the point is inside the domain; outside, *u and *v are unspecified but
//     // finite where possible. T: double, Dual<N>, or the vector lanes of a kernel.
//     template <class T>
//     static auto Project(const LensDomain& domain, const T* params, int num_params,
//                         T x, T y, T z, T* u, T* v);
//     // Unit ray of a pixel; false if the pixel has none. Always in double. |Project(ray) - pixel|
//     // is below 1e-9 px where it returns true.
//     static bool Unproject(const LensDomain& domain, const double* params, int num_params,
//                           double u, double v, double* ray);
//     // Radians: the largest angle between the axis and a point of the domain.
//     // (LensDomain::max_angle.)
//   };
//
// Names for T: + - * / unary -, < <= > >= (a mask: bool for scalars), and
//   Sqrt Abs Min Max Atan2 Atan Sin Cos Tan Asin, Select(mask, a, b), AndMask(a, b), OrMask(a, b),
//   T(double) for constants. No `if` on a T: use Select.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>

namespace gsut {

// The valid domain of one lens with its parameters.
struct LensDomain {
  double max_angle = 0.0;   // radians from the axis; the domain is angle < max_angle
  double max_radius = 0.0;  // the lens' own distorted radius at max_angle (its unit: see the lens)
  std::array<double, 4> limits = {};  // further limits; each lens says what it keeps here
};

}  // namespace gsut
