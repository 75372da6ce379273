// Shared text of lenses (see contract.h): the radial-tangential distortion of OpenCV.
//
// With x = X/Z, y = Y/Z, r2 = x^2 + y^2:
//   g  = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3)
//   x' = x g + 2 p1 x y + p2 (r2 + 2 x^2) + s1 r2 + s2 r2^2
//   y' = y g + p1 (r2 + 2 y^2) + 2 p2 x y + s3 r2 + s4 r2^2
// and, for 14 coefficients, the tilted sensor: (x'', y'') = the homogeneous vector
//   [[R22, 0, -R02], [0, R22, -R12], [0, 0, 1]] R (x', y', 1),  R = Ry(ty) Rx(tx),
// divided by its third component, which multiplied out is
//   x'' = cos(tx) x' / d,  y'' = (cos(ty) y' - sin(tx) sin(ty) x') / d,
//   d = sin(ty) x' - cos(ty) sin(tx) y' + cos(ty) cos(tx).
// Then u = fx x'' + cx, v = fy y'' + cy.
//
// Coefficients, dimensionless but tx, ty in radians: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4
// [tx ty]]]]. Domain: Z > 0 and sqrt(r2) below the radius of RadialTangentialDomain, whose square
// is limits[0]. Source: OpenCV's documentation of the module calib3d.

template <int kCoefficients>
struct RadialTangential {
  static_assert(kCoefficients == 4 || kCoefficients == 5 || kCoefficients == 8 ||
                kCoefficients == 12 || kCoefficients == 14);

  static bool AcceptsParams(int num_params) { return num_params == 4 + kCoefficients; }

  static LensDomain CheckedDomain(const char* name, const char* param_names, const double* params,
                                  int num_params, double angle_limit) {
    CheckFocalParams(name, param_names, params, num_params);
    return RadialTangentialDomain(params, num_params, angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T plane_x = x / z;
    const T plane_y = y / z;
    const T square = plane_x * plane_x + plane_y * plane_y;
    const auto inside = AndMask(z > T(0.0), square < T(domain.limits[0]));
    T distorted_x(0.0), distorted_y(0.0);
    Distort(params + 4, plane_x, plane_y, &distorted_x, &distorted_y);
    return AndMask(inside, ImagePlane::ToPixel(params, distorted_x, distorted_y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int num_params, double u,
                        double v, double* ray) {
    return UnprojectRadialTangential(domain, params, num_params, u, v, ray);
  }

  // The distortion alone; C is T, or double for constant coefficients.
  template <class C, class T>
  static void Distort(const C* coefficients, T x, T y, T* distorted_x, T* distorted_y) {
    const auto c = [coefficients](int i) { return T(coefficients[i]); };
    const T one(1.0), two(2.0);
    const T square_x = x * x;
    const T square_y = y * y;
    const T square = square_x + square_y;
    const T twice_xy = two * x * y;
    T factor = c(0) + square * c(1);
    if constexpr (kCoefficients >= 5) factor = c(0) + square * (c(1) + square * c(4));
    factor = one + square * factor;
    if constexpr (kCoefficients >= 8) {
      factor = factor / (one + square * (c(5) + square * (c(6) + square * c(7))));
    }
    T u = x * factor + c(2) * twice_xy + c(3) * (square + two * square_x);
    T v = y * factor + c(3) * twice_xy + c(2) * (square + two * square_y);
    if constexpr (kCoefficients >= 12) {
      u = u + square * (c(8) + square * c(9));
      v = v + square * (c(10) + square * c(11));
    }
    if constexpr (kCoefficients >= 14) Tilt(c(12), c(13), &u, &v);
    *distorted_x = u;
    *distorted_y = v;
  }

  // The constant terms of the homogeneous vector cancel exactly; multiplied out, they would cost a
  // float all its digits near the axis.
  template <class T>
  static void Tilt(T angle_x, T angle_y, T* u, T* v) {
    const T sin_x = Sin(angle_x), cos_x = Cos(angle_x);
    const T sin_y = Sin(angle_y), cos_y = Cos(angle_y);
    const T depth = sin_y * *u - cos_y * sin_x * *v + cos_y * cos_x;
    const T tilted_v = cos_y * *v - sin_x * sin_y * *u;
    *u = cos_x * *u / depth;
    *v = tilted_v / depth;
  }
};
