// thin_prism_fisheye: equidistant fisheye with radial, tangential and thin-prism distortion.
//
//   (x, y) = theta (X, Y) / |(X, Y)|, theta the angle from the axis; q = x^2 + y^2;
//   g = 1 + k1 q + k2 q^2 + k3 q^3 + k4 q^4
//   u = fx (x g + 2 p1 x y + p2 (q + 2 x^2) + sx1 q) + cx
//   v = fy (y g + p1 (q + 2 y^2) + 2 p2 x y + sy1 q) + cy
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then
// k1 k2 p1 p2 k3 k4 sx1 sy1, dimensionless. COLMAP's THIN_PRISM_FISHEYE is this lens. Domain: up to
// the first circle on which the map folds (plane_inverses.h); points with Z <= 0 are seen. Inverse:
// Newton, safeguarded (plane_map.h). Source: COLMAP's documentation of its camera models.

struct ThinPrismFisheye : WarpedEquidistant<ThinPrismFisheye> {
  static constexpr const char* kName = "thin_prism_fisheye";
  static constexpr const char* kParamNames = "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1";
  static constexpr LensExample kExamples[] = {
      {"ETH3D, DSLR with a wide lens, solved by COLMAP",
       6048,
       4032,
       12,
       {3411.42, 3410.02, 3041.29, 2014.07, 0.21047, 0.21102, -5.36231e-06, 0.00051541, -0.158023,
        0.406856, -8.46499e-05, 0.000861313}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 12; }

  // C is T, or double for constant coefficients.
  template <class C, class T>
  static void Distort(const C* coefficients, T x, T y, T* u, T* v) {
    const auto c = [coefficients](int i) { return T(coefficients[i]); };
    const T two(2.0);
    const T square_x = x * x, square_y = y * y;
    const T q = square_x + square_y;
    const T twice_xy = two * x * y;
    const T g = T(1.0) + q * (c(0) + q * (c(1) + q * (c(4) + q * c(5))));
    *u = x * g + c(2) * twice_xy + c(3) * (q + two * square_x) + c(6) * q;
    *v = y * g + c(2) * (q + two * square_y) + c(3) * twice_xy + c(7) * q;
  }
};
