// mei: catadioptric and fisheye lenses; the unified sphere, then radial-tangential distortion.
//
//   (x, y) = (X, Y) / (Z + xi n), n = |P|; (x', y') = the distortion of families/
//   radial_tangential.h with 4 coefficients;
//   u = fx x' + skew y' + cx, v = fy y' + cy
//
// Parameters: fx fy cx cy skew in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then xi
// >= 0 and k1 k2 p1 p2, dimensionless. OpenCV's omnidir and Kalibr's omni-radtan are this lens.
// Domain: Z > -xi n for xi < 1 (a pole), Z > -n / xi beyond (a fold), and the disc of (x, y) in
// which the distortion is one-to-one, whose squared radius is limits[0]. Inverse: Newton for the
// distortion, closed for the sphere. Source: Mei and Rives, "Single view point omnidirectional
// camera calibration from planar grids", ICRA 2007.

struct Mei {
  static constexpr const char* kName = "mei";
  static constexpr const char* kParamNames = "fx fy cx cy skew xi k1 k2 p1 p2";
  static constexpr LensExample kExamples[] = {
      {"left fisheye on the roof of a car, as its data set's authors calibrated it",
       1400,
       1400,
       10,
       {1336.3220825849971, 1335.7883350012958, 717.4432351012663, 706.2649830822159, 0.0,
        2.213404750785489, 0.016798235660113681, 1.6548773243373522, 0.00042223943394772046,
        0.00042462134260997584}},
      {"a mirror: xi below 1, with skew",
       640,
       480,
       10,
       {260.0, 259.0, 318.5, 242.25, 0.35, 0.89, -0.12, 0.021, 0.0007, -0.0004}},
  };

  static constexpr int kFitHeld[] = {4};  // no skew

  static bool AcceptsParams(int num_params) { return num_params == 10; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& at) {
    return {at.With({0.0, 1.0, 0.0, 0.0, 0.0, 0.0}, 2.0)};
  }

  // The distortion's own lens: fx fy cx cy k1 k2 p1 p2.
  static std::array<double, 8> PlaneParams(const double* params) {
    return {params[0], params[1], params[2], params[3], params[6], params[7], params[8], params[9]};
  }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    constexpr double kLargestXi = 1e3;    // beyond, the sphere is a plane to double's rounding
    constexpr double kLargestSkew = 0.1;  // of fx: larger ones are mistaken orders of parameters
    CheckFocalParams(kName, kParamNames, params, num_params);
    CheckLensParam(kName, "skew", params[4], -kLargestSkew * params[0], kLargestSkew * params[0]);
    CheckLensParam(kName, "xi", params[5], 0.0, kLargestXi);
    const double xi = params[5];
    const double edge = std::min(xi < 1.0 ? std::acos(-xi) : std::acos(-1.0 / xi), angle_limit);
    const double depth = xi + std::cos(edge);
    const bool at_pole = !(edge < angle_limit) && xi <= 1.0;
    const double plane_angle = at_pole ? 0.5 * kPi : std::atan2(std::sin(edge), depth);
    const std::array<double, 8> plane = PlaneParams(params);
    LensDomain domain = RadialTangentialDomain(plane.data(), 8, plane_angle);
    // At the sphere's own fold the radius stands still: the cone ends the domain, not the disc.
    constexpr double kSlack = 1e-12;
    if (xi > 1.0) domain.limits[0] *= 1.0 + kSlack;
    double ray[3];
    ToSphere(xi, std::sqrt(domain.limits[0]), 0.0, ray);
    SetCone(std::min(std::atan2(ray[0], ray[2]), edge), &domain);
    return domain;
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T square_h = x * x + y * y;
    const T n = Sqrt(square_h + z * z);
    const auto in_cone = Cone::Contains(domain, Sqrt(square_h), z, n);
    const T depth = z + params[5] * n;
    const T plane_x = x / depth, plane_y = y / depth;
    const T square = plane_x * plane_x + plane_y * plane_y;
    T distorted_x(0.0), distorted_y(0.0);
    RadialTangential<4>::Distort(params + 6, plane_x, plane_y, &distorted_x, &distorted_y);
    const T skewed_x = distorted_x + params[4] / params[0] * distorted_y;
    return AndMask(AndMask(in_cone, square < T(domain.limits[0])),
                   ImagePlane::ToPixel(params, skewed_x, distorted_y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    const std::array<double, 8> plane = PlaneParams(params);
    const double unskewed = u - params[4] * ((v - params[3]) / params[1]);
    double gnomonic[3];
    if (!UnprojectRadialTangential(domain, plane.data(), 8, unskewed, v, gnomonic)) return false;
    double direction[3];
    ToSphere(params[5], gnomonic[0] / gnomonic[2], gnomonic[1] / gnomonic[2], direction);
    return RayInCone(domain, direction[0], direction[1], direction[2], ray);
  }

  static void Rescale(double* params, int /*num_params*/, double scale_x, double scale_y) {
    params[0] *= scale_x;
    params[1] *= scale_y;
    params[2] *= scale_x;
    params[3] *= scale_y;
    params[4] *= scale_x;
  }

  // The direction whose plane coordinates are (x, y).
  static void ToSphere(double xi, double x, double y, double* direction) {
    const double square = x * x + y * y;
    const double under_root = std::max(0.0, 1.0 + (1.0 - xi) * (1.0 + xi) * square);
    const double scale = (xi + std::sqrt(under_root)) / (1.0 + square);
    direction[0] = scale * x;
    direction[1] = scale * y;
    direction[2] = scale - xi;
  }
};
