// stereographic: keeps angles; circles on the sphere of directions stay circles.
//
//   u = 2 fx X / (n + Z) + cx, v = 2 fy Y / (n + Z) + cy, n = |P|
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. mrcal's
// LENSMODEL_STEREOGRAPHIC is this lens. Domain: every direction but straight behind, where pixels
// go to infinity. Behind the camera n + Z is taken as (X^2 + Y^2) / (n - Z), which does not cancel.
// Inverse: closed. Source: mrcal's documentation of its lens models.

struct Stereographic {
  static constexpr const char* kName = "stereographic";
  static constexpr const char* kParamNames = "fx fy cx cy";
  static constexpr LensExample kExamples[] = {
      {"a view of 180 degrees across, as mrcal reprojects to",
       800,
       600,
       4,
       {200.0, 202.0, 399.5, 301.25}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 4; }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckFocalParams(kName, kParamNames, params, num_params);
    return RadialDomain(params, kPi, angle_limit,
                        [](double angle) { return 2.0 * std::tan(0.5 * angle); });
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T square = x * x + y * y;
    const T n = Sqrt(square + z * z);
    const auto inside = Cone::Contains(domain, Sqrt(square), z, n);
    const T scale = Select(z > T(0.0), T(2.0) / (n + z), T(2.0) * (n - z) / square);
    return AndMask(inside, ImagePlane::ToPixel(params, scale * x, scale * y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    double x = 0.0, y = 0.0;
    if (!FromPixel(params, u, v, &x, &y)) return false;
    const double square = x * x + y * y;
    if (!(square < domain.max_radius * domain.max_radius)) return false;
    return RayInCone(domain, x, y, 1.0 - 0.25 * square, ray);
  }
};
