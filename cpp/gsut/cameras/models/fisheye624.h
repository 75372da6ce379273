// fisheye624: fisheye with 6 radial, 2 tangential and 4 thin-prism terms (Project Aria's glasses).
//
//   theta the angle from the axis, (a, b) = theta (1 + k0 theta^2 + ... + k5 theta^12) times the
//   direction of (X, Y); q = a^2 + b^2;
//   u = fx (a + p0 (q + 2 a^2) + 2 p1 a b + s0 q + s1 q^2) + cx
//   v = fy (b + 2 p0 a b + p1 (q + 2 b^2) + s2 q + s3 q^2) + cy
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then
// k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3, dimensionless. COLMAP's RAD_TAN_THIN_PRISM_FISHEYE and
// Project Aria's FISHEYE624 are this lens. Domain: up to the first circle on which the map folds
// (plane_inverses.h). Inverse: Newton, safeguarded (plane_map.h). Source: Project Aria's
// documentation of its camera models.

struct Fisheye624 : WarpedEquidistant<Fisheye624> {
  static constexpr const char* kName = "fisheye624";
  static constexpr const char* kParamNames = "fx fy cx cy k0 k1 k2 k3 k4 k5 p0 p1 s0 s1 s2 s3";
  static constexpr LensExample kExamples[] = {
      {"Project Aria generation 1, colour camera, factory calibration",
       1408,
       1408,
       16,
       {610.9410078676575, 610.9410078676575, 715.6148341104505, 717.2147122529825,
        0.4060356696288849, -0.489948419647729, 0.1745652818132035, 1.132983686620576,
        -1.701635218233742, 0.6511555293441647, 0.0006211469747214578, 1.932200015697112e-05,
        -1.485525650871087e-05, 0.0002601225712292815, -0.0006582109778598294,
        3.761395141407565e-05}},
      {"Project Aria generation 1, left SLAM camera, factory calibration",
       640,
       480,
       16,
       {241.0924812381835, 241.0924812381835, 317.1383122025797, 237.5248677681421,
        -0.02556123097687011, 0.09847331936104091, -0.06750086779081803, 0.009484251398731337,
        0.002331757393673257, -0.0005746307420191288, 0.001146236083742114, -0.001498851487358559,
        -0.00123337629770084, -0.0001196746852568052, 0.002285696451761395,
        -5.648804313856532e-05}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 16; }

  // C is T, or double for constant coefficients.
  template <class C, class T>
  static void Distort(const C* coefficients, T x, T y, T* u, T* v) {
    const auto c = [coefficients](int i) { return T(coefficients[i]); };
    const T two(2.0);
    const T square = x * x + y * y;
    T g = c(5);
    for (int i = 4; i >= 0; --i) g = g * square + c(i);
    g = T(1.0) + g * square;
    const T a = x * g, b = y * g;
    const T square_a = a * a, square_b = b * b;
    const T q = square_a + square_b;
    const T twice_ab = two * a * b;
    *u = a + c(6) * (q + two * square_a) + c(7) * twice_ab + q * (c(8) + q * c(9));
    *v = b + c(6) * twice_ab + c(7) * (q + two * square_b) + q * (c(10) + q * c(11));
  }
};
