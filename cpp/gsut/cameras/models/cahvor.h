// cahvor: the lens of planetary rovers; radial distortion about an optical axis of its own.
//
//   o = (sin(alpha) cos(beta), sin(beta), cos(alpha) cos(beta)), w = P.o, tau = |P|^2 / w^2 - 1,
//   P' = P + (r0 + r1 tau + r2 tau^2) (P - w o), u = fx X'/Z' + cx, v = fy Y'/Z' + cy
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then alpha
// beta, radians, and r0 r1 r2, dimensionless. mrcal's LENSMODEL_CAHVOR is this lens. Domain: Z > 0,
// w > 0, Z' > 0, up to the first circle of (X/Z, Y/Z) on which the map folds (plane_inverses.h).
// Inverse: Newton, safeguarded (plane_map.h). Source: Yakimovsky and Cunningham 1978; Gennery,
// "Least-squares camera calibration including lens distortion", 2001; mrcal's documentation.

struct Cahvor {
  static constexpr const char* kName = "cahvor";
  static constexpr const char* kParamNames = "fx fy cx cy alpha beta r0 r1 r2";
  static constexpr LensExample kExamples[] = {
      {"a rover's navigation camera: 45 degrees across",
       1024,
       1024,
       9,
       {1226.0, 1225.5, 510.5, 514.25, 0.0021, -0.0034, 2e-5, -0.0145, 0.0061}},
      {"a hazard camera: wide, with a tilted axis",
       640,
       480,
       9,
       {312.0, 311.0, 320.5, 242.0, 0.021, -0.017, 0.0007, -0.084, 0.011}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 9; }

  static PlaneMap Map(const double* params) {
    return MakePlaneMap([params](const auto& x, const auto& y, auto* u, auto* v) {
      Distort(params + 4, x, y, u, v);
    });
  }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    constexpr double kLargestAngle = 0.5;  // of the optical axis, radians
    CheckFocalParams(kName, kParamNames, params, num_params);
    CheckLensParam(kName, "alpha", params[4], -kLargestAngle, kLargestAngle);
    CheckLensParam(kName, "beta", params[5], -kLargestAngle, kLargestAngle);
    return PlaneChartDomain(PlaneChart::kGnomonic, params, Map(params), angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T plane_x = x / z, plane_y = y / z;
    const T square = plane_x * plane_x + plane_y * plane_y;
    const auto inside = AndMask(z > T(0.0), square < T(domain.limits[0]));
    T distorted_x(0.0), distorted_y(0.0);
    Distort(params + 4, plane_x, plane_y, &distorted_x, &distorted_y);
    return AndMask(inside, ImagePlane::ToPixel(params, distorted_x, distorted_y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    return UnprojectPlaneChart(PlaneChart::kGnomonic, domain, params, Map(params), u, v, ray);
  }

  // Of the point (x, y, 1); NaN behind the lens. C is T, or double for constant coefficients.
  template <class C, class T>
  static void Distort(const C* coefficients, T x, T y, T* u, T* v) {
    const auto c = [coefficients](int i) { return T(coefficients[i]); };
    const T one(1.0);
    const T cos_beta = Cos(c(1));
    const T axis[3] = {Sin(c(0)) * cos_beta, Sin(c(1)), Cos(c(0)) * cos_beta};
    const T along = x * axis[0] + y * axis[1] + axis[2];
    const T off[3] = {x - along * axis[0], y - along * axis[1], one - along * axis[2]};
    // |P|^2 / w^2 - 1, without the cancellation.
    const T tau = (off[0] * off[0] + off[1] * off[1] + off[2] * off[2]) / (along * along);
    const T factor = c(2) + tau * (c(3) + tau * c(4));
    const T depth = one + factor * off[2];
    const T front =
        Select(Min(along, depth) > T(0.0), one, T(std::numeric_limits<double>::quiet_NaN()));
    *u = (x + factor * off[0]) / depth * front;
    *v = (y + factor * off[1]) / depth * front;
  }
};
