// extended_unified: the extended unified camera model (EUCM) of wide and fisheye lenses.
//
//   d = sqrt(beta (X^2 + Y^2) + Z^2), u = fx X / (alpha d + (1 - alpha) Z) + cx, v likewise.
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then alpha in
// [0, 1] and beta > 0. COLMAP's EUCM and Kalibr's eucm are this lens. Domain and its edge:
// families/unified_sphere.h. Inverse: closed. Source: Khomutenko, Garcia and Martinet, "An enhanced
// unified camera model", RA-L 2016.

struct ExtendedUnified {
  static constexpr const char* kName = "extended_unified";
  static constexpr const char* kParamNames = "fx fy cx cy alpha beta";
  static constexpr LensExample kExamples[] = {
      {"TUM-VI cam0, solved with basalt",
       512,
       512,
       6,
       {191.14799816648748, 191.13150946585135, 255.45857715233118, 257.3815466235898,
        0.6291060871161842, 1.0418067403139693}},
      {"EuRoC MAV cam0, solved with basalt",
       752,
       480,
       6,
       {460.76484651566468, 459.4051018049483, 366.3937161309615, 249.83499869752445,
        0.5903365915227143, 1.127468196965374}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 6; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& at) {
    return {at.With({0.5, 1.0})};
  }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    // Of beta: calibrated ones are near 1, and squares of these do not overflow a float.
    constexpr double kSmallest = 1e-6;
    constexpr double kLargest = 1e6;
    CheckFocalParams(kName, kParamNames, params, num_params);
    CheckLensParam(kName, "alpha", params[4], 0.0, 1.0);
    CheckLensParam(kName, "beta", params[5], kSmallest, kLargest);
    return UnifiedSphere::MakeDomain(params, params[4], params[5], angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    return UnifiedSphere::Project(domain, params, params[4], params[5], x, y, z, u, v);
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    return UnifiedSphere::Unproject(domain, params, params[4], params[5], u, v, ray);
  }
};
