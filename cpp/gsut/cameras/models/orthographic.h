// orthographic: the telecentric lens; parallel rays, no perspective.
//
//   u = fx X + cx, v = fy Y + cy
//
// Parameters: fx fy in pixels a world unit, cx cy in pixels; (0.5, 0.5) is the centre of the
// top-left pixel. Every ray looks along +z and starts in the plane z = 0, at the pixel's own place.
// Domain: Z > 0; its angle says nothing about points, and a valid field angle cuts nothing off.
// Inverse: closed. Source: parallel projection; gsplat's "ortho" camera is this lens.

struct Orthographic {
  static constexpr const char* kName = "orthographic";
  static constexpr const char* kParamNames = "fx fy cx cy";
  static constexpr LensExample kExamples[] = {
      {"a telecentric lens: 4 mm across, in millimetres", 640, 480, 4, {160, 160, 320, 240}},
  };
  static constexpr bool kHasOrigins = true;
  static constexpr bool kIsParallel = true;

  static bool AcceptsParams(int num_params) { return num_params == 4; }

  static LensDomain MakeDomain(const double* params, int num_params, double /*angle_limit*/ = kPi) {
    CheckFocalParams(kName, kParamNames, params, num_params);
    LensDomain domain;
    domain.max_angle = 0.5 * kPi;
    return domain;
  }

  template <class T>
  static auto Project(const LensDomain& /*domain*/, const T* params, int /*num_params*/, T x, T y,
                      T z, T* u, T* v) {
    return AndMask(z > T(0.0), ImagePlane::ToPixel(params, x, y, u, v));
  }

  static bool UnprojectLine(const LensDomain& /*domain*/, const double* params, int /*num_params*/,
                            double u, double v, double* origin, double* ray) {
    origin[2] = ray[0] = ray[1] = 0.0;
    ray[2] = 1.0;
    return FromPixel(params, u, v, &origin[0], &origin[1]);
  }

  static bool Unproject(const LensDomain& domain, const double* params, int num_params, double u,
                        double v, double* ray) {
    double origin[3];
    return UnprojectLine(domain, params, num_params, u, v, origin, ray);
  }
};
