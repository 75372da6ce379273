// Shared text of lenses (see contract.h): the distortion of photogrammetry, as Metashape has it.
//
//   q = x^2 + y^2, g = 1 + k1 q + k2 q^2 + k3 q^3 + k4 q^4
//   x' = x g + 2 p1 x y + p2 (q + 2 x^2), y' = y g + p1 (q + 2 y^2) + 2 p2 x y
//   u = fx x' + skew y' + cx, v = fy y' + cy
//
// Parameters: fx fy cx cy skew in pixels, then k1 k2 k3 k4 p1 p2, dimensionless; p1 and p2 as
// OpenCV names them, which are Metashape's P2 and P1. Source: Brown, "Decentering distortion of
// lenses", Photogrammetric Engineering, 1966; Metashape's manual, appendix "Camera models".

struct Brown {
  static constexpr const char* kParamNames = "fx fy cx cy skew k1 k2 k3 k4 p1 p2";

  static bool AcceptsParams(int num_params) { return num_params == 11; }

  static void CheckParams(const char* name, const double* params, int num_params) {
    constexpr double kLargestSkew = 0.1;  // of fx
    CheckFocalParams(name, kParamNames, params, num_params);
    CheckLensParam(name, "skew", params[4], -kLargestSkew * params[0], kLargestSkew * params[0]);
  }

  // In focal lengths, the skew included.
  static PlaneMap Map(const double* params) {
    return MakePlaneMap(
        [params](const auto& x, const auto& y, auto* u, auto* v) { Distort(params, x, y, u, v); });
  }

  // C is T, or double for constant coefficients.
  template <class C, class T>
  static void Distort(const C* params, T x, T y, T* u, T* v) {
    const auto c = [params](int i) { return T(params[i]); };
    const T two(2.0);
    const T square_x = x * x, square_y = y * y;
    const T q = square_x + square_y;
    const T twice_xy = two * x * y;
    const T g = T(1.0) + q * (c(5) + q * (c(6) + q * (c(7) + q * c(8))));
    *v = y * g + c(9) * (q + two * square_y) + c(10) * twice_xy;
    *u = x * g + c(9) * twice_xy + c(10) * (q + two * square_x) + c(4) / c(0) * *v;
  }

  static void Rescale(double* params, int /*num_params*/, double scale_x, double scale_y) {
    params[0] *= scale_x;
    params[1] *= scale_y;
    params[2] *= scale_x;
    params[3] *= scale_y;
    params[4] *= scale_x;
  }
};
