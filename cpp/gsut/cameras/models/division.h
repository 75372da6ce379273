// division: one parameter from barrel to pincushion, and the simplest inverse of all.
//
//   rho = |(x, y)| with x = (u - cx) / fx, y = (v - cy) / fy; the ray is (x, y, 1 + k rho^2), so
//   u = fx 2 X / (Z + s) + cx, v likewise, s = sqrt(Z^2 - 4 k R^2), R = |(X, Y)|.
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then k,
// dimensionless; barrel distortion has k < 0. COLMAP's SIMPLE_DIVISION and DIVISION are this lens.
// Domain: k < 0: every direction whose pixel is near (rho goes to infinity straight behind; behind
// the camera Z + s is taken as -4 k R^2 / (s - Z), which does not cancel). k > 0: R / Z below
// 1 / (2 sqrt(k)), where the pixel's derivative is infinite. Inverse: closed. Source: Fitzgibbon,
// "Simultaneous linear estimation of multiple view geometry and lens distortion", CVPR 2001.

struct Division {
  static constexpr const char* kName = "division";
  static constexpr const char* kParamNames = "fx fy cx cy k";
  static constexpr LensExample kExamples[] = {
      {"the phone of opencv4.h with the division model closest to it",
       1080,
       1920,
       5,
       {1375.52, 1374.49, 554.558, 965.268, 0.0412}},
      {"a fisheye: barrel distortion that reaches behind the camera",
       640,
       480,
       5,
       {190.0, 191.0, 318.5, 243.25, -0.31}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 5; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& at) { return {at.With({-0.1})}; }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckFocalParams(kName, kParamNames, params, num_params);
    const double k = params[4];
    const double edge = k > 0.0 ? std::atan(0.5 / std::sqrt(k)) : kPi;
    return RadialDomain(params, edge, angle_limit, [k](double angle) {
      const double sine = std::sin(angle), cosine = std::cos(angle);
      const double root = std::sqrt(std::max(0.0, cosine * cosine - 4.0 * k * sine * sine));
      return cosine > 0.0 ? 2.0 * sine / (cosine + root) : (root - cosine) / (-2.0 * k * sine);
    });
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T k = params[4];
    const T square = x * x + y * y;
    const T square_z = z * z;
    const auto in_cone = Cone::Contains(domain, Sqrt(square), z, Sqrt(square + square_z));
    const T under_root = square_z - T(4.0) * k * square;
    const auto inside = AndMask(in_cone, under_root > T(0.0));
    const T root = Sqrt(under_root);
    const T scale = Select(z > T(0.0), T(2.0) / (z + root), (z - root) / (T(2.0) * k * square));
    return AndMask(inside, ImagePlane::ToPixel(params, scale * x, scale * y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    double x = 0.0, y = 0.0;
    if (!FromPixel(params, u, v, &x, &y)) return false;
    const double square = x * x + y * y;
    if (!(square < domain.max_radius * domain.max_radius)) return false;
    return RayInCone(domain, x, y, 1.0 + params[4] * square, ray);
  }
};
