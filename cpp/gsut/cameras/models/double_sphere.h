// double_sphere: the double sphere camera model of wide and fisheye lenses.
//
//   n = |P|, k = xi n + Z, d = sqrt(X^2 + Y^2 + k^2),
//   u = fx X / (alpha d + (1 - alpha) k) + cx, v likewise.
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then xi in
// (-1, 1) and alpha in [0, 1]. Kalibr's and basalt's ds is this lens. The point is first cast on
// the sphere around -xi, then goes through a unified lens (families/unified_sphere.h), whose domain
// ends at k = -w sqrt(X^2 + Y^2 + k^2). So the domain is Z > n (-w c - xi) with
// c = sqrt(1 - xi^2 (1 - w^2)) - w xi; the bound printed in the source (their w2) is another one,
// which for alpha < 1/2 and xi < 0 reaches beyond the pole. Inverse: closed. Source: Usenko, Demmel
// and Cremers, "The double sphere camera model", 3DV 2018.

struct DoubleSphere {
  static constexpr const char* kName = "double_sphere";
  static constexpr const char* kParamNames = "fx fy cx cy xi alpha";
  static constexpr LensExample kExamples[] = {
      {"fisheye of basalt's own tests",
       1024,
       1024,
       6,
       {402.5, 400.0, 505.5, 509.5, -0.075347, 0.743925}},
      {"a lens with a pole: alpha below 1/2",
       640,
       480,
       6,
       {150.0, 151.0, 321.5, 238.25, 0.2, 0.35}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 6; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& at) {
    return {at.With({0.0, 0.5})};
  }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    constexpr double kLargestXi = 0.999;
    CheckFocalParams(kName, kParamNames, params, num_params);
    CheckLensParam(kName, "xi", params[4], -kLargestXi, kLargestXi);
    CheckLensParam(kName, "alpha", params[5], 0.0, 1.0);
    const double xi = params[4], alpha = params[5];
    const double w = alpha <= 0.5 ? alpha / (1.0 - alpha) : (1.0 - alpha) / alpha;
    const double c = std::sqrt(1.0 - xi * xi * (1.0 - w * w)) - w * xi;
    const double cosine_edge = -w * c - xi;
    // sin = c sqrt(1 - w^2), which keeps its digits where the cosine is near -1.
    const double edge = std::atan2(c * std::sqrt((1.0 - w) * (1.0 + w)), cosine_edge);
    return RadialDomain(params, edge, angle_limit, [xi, alpha](double angle) {
      const double sine = std::sin(angle);
      const double k = xi + std::cos(angle);
      return sine / (alpha * std::sqrt(sine * sine + k * k) + (1.0 - alpha) * k);
    });
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T xi = params[4], alpha = params[5];
    const T square = x * x + y * y;
    const T n = Sqrt(square + z * z);
    const auto inside = Cone::Contains(domain, Sqrt(square), z, n);
    const T k = xi * n + z;
    const T scale = UnifiedSphere::Scale(alpha, Sqrt(square + k * k), square, k);
    return AndMask(inside, ImagePlane::ToPixel(params, scale * x, scale * y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    const double xi = params[4], alpha = params[5];
    double x = 0.0, y = 0.0;
    if (!FromPixel(params, u, v, &x, &y)) return false;
    const double square = x * x + y * y;
    if (!(square < domain.max_radius * domain.max_radius)) return false;
    // On the second sphere, then back to the first.
    const double depth = UnifiedSphere::Depth(alpha, 1.0, square);
    const double scale = (depth * xi + std::sqrt(depth * depth + (1.0 - xi * xi) * square)) /
                         (depth * depth + square);
    return RayInCone(domain, scale * x, scale * y, scale * depth - xi, ray);
  }
};
