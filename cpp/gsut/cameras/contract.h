// What a lens must hold. One lens = one file under cameras/models; the build finds it.
//
// A lens file is read several times, in different namespaces: once for scalars (double, Dual) by
// visit_lens.h, and once per instruction set by the vector kernels (lens_kernels-inl.h). All other
// code passes batches of points through Camera (double) or ProjectPoints (float). A lens file
// therefore has no include guard, no #include and no namespace, and holds one struct, named like
// the file in PascalCase (opencv5.h -> Opencv5), that uses only the names below, unqualified. Text
// that several lenses share lies under cameras/families by the same rules; the generated list of
// files reads the families first. Code that needs only double (domain, inverse) may use std::; if
// it is longer than a closed form, it is called from there and declared by the headers below.
//
// clang-format off
//
//   struct KannalaBrandt {
//     static constexpr const char* kName = "kannala_brandt";
//
//     // "fx fy cx cy k1 ...", for messages and documentation.
//     static constexpr const char* kParamNames = ...;
//
//     // Real lenses with their origin; the tests loop over them.
//     static constexpr LensExample kExamples[] = {...};
//
//     // True if a parameter vector of this length is a lens.
//     static bool AcceptsParams(int num_params);
//
//     // The one-to-one domain connected to the axis, found once on load, in double, cut at
//     // angle_limit (radians). Throws InputError if the parameters describe no lens. A panorama
//     // states here where its image repeats and around which directions it turns (LensDomain).
//     static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi);
//
//     // Pixel of a point in the camera frame (x right, y down, z forward; any length but 0).
//     // Returns the mask "inside the domain, and no pixel coordinate beyond kMaxPixel"; where it
//     // is false, *u and *v are unspecified. T: double, Dual<N>, or the vector lanes of a kernel.
//     template <class T>
//     static auto Project(const LensDomain& domain, const T* params, int num_params,
//                         T x, T y, T z, T* u, T* v);
//
//     // Unit ray of a pixel; false if the pixel has none. Always in double. Where it returns true,
//     // |Project(ray) - pixel| is below kInverseTolerance (lens_constants.h).
//     static bool Unproject(const LensDomain& domain, const double* params, int num_params,
//                           double u, double v, double* ray);
//
//     // Optional: the parameters for an image resized by (scale_x, scale_y) about the pixel corner
//     // (0, 0). Without it the first four parameters are taken as fx fy cx cy.
//     static void Rescale(double* params, int num_params, double scale_x, double scale_y);
//
//     // Optional: the image's size is part of the lens, and MakeDomain takes (..., angle_limit,
//     // width, height).
//     static constexpr bool kTakesSize = true;
//
//     // Optional, for lenses whose rays do not meet in the origin. Project then depends on the
//     // point's distance, and every ray has an origin of its own, in the camera frame.
//     static constexpr bool kHasOrigins = true;
//     static bool UnprojectLine(const LensDomain& domain, const double* params, int num_params,
//                               double u, double v, double* origin, double* ray);
//
//     // Optional, with kHasOrigins: every ray looks along the axis.
//     static constexpr bool kIsParallel = true;
//
//     // Optional, for lenses with tables of parameters. Project then has `template <class T,
//     // class P>` and takes `const P* params`; P is T for scalars and float for the lanes of a
//     // kernel. Entries are read as T(params[i]) at an i known beforehand, or at an i of type T
//     // that holds whole numbers: At<T>(params, i) reads one, and
//     //   SumRows(params, i, stride, rows, columns, weight, sums)
//     // writes sums[k] = sum over j < rows of weight[j] params[i + j stride + k] for k < columns;
//     // rows at most 4, columns at most kMaxColumns. Float tables have kMaxColumns more entries.
//     static constexpr bool kHasTable = true;
//
//     // Optional: indices of parameters that choose the formula, or that must be 0; derivatives by
//     // them mean nothing.
//     static constexpr int kChoices[] = {0, 1};
//
//     // Optional, for fits of this lens to another: parameters to start from; of several starts
//     // the best result counts. Without it: fx fy cx cy and then zeros.
//     static std::vector<std::vector<double>> FitStarts(const FitAxis& at);
//
//     // Optional: indices of parameters that a fit holds, and of those that it holds unless it
//     // has points at several distances.
//     static constexpr int kFitHeld[] = {4};
//     static constexpr int kFitNear[] = {9, 10, 11};
//   };
//
// clang-format on
//
// Names for T: + - * / unary -, < <= > >= (a mask: bool for scalars), and
//   Sqrt Abs Min Max Atan2 Atan Sin Cos Tan Asin Floor, Select(mask, a, b), AndMask(a, b),
//   OrMask(a, b), T(double) for constants. No `if` on a T: use Select. With Dual, the branch that
//   Select drops may hold NaN; the branch that it keeps must have finite derivatives.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <vector>

#include "gsut/cameras/fit_axis.h"
#include "gsut/cameras/lens_checks.h"
#include "gsut/cameras/lens_domain.h"
#include "gsut/cameras/plane_inverses.h"
#include "gsut/cameras/radial_inverses.h"
#include "gsut/cameras/special_inverses.h"
