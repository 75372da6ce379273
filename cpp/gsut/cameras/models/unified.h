// unified: the unified camera model of wide and fisheye lenses, one parameter beyond the pinhole.
//
//   n = |P|, u = fx X / (alpha n + (1 - alpha) Z) + cx, v likewise.
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then alpha in
// [0, 1]: 0 is the pinhole. Domain and its edge: families/unified_sphere.h; points with Z <= 0 are
// seen unless alpha is 0 or 1. Inverse: closed. Source: Geyer and Daniilidis, "A unifying theory
// for central panoramic systems", ECCV 2000, in the form of Usenko, Demmel and Cremers, "The double
// sphere camera model", 3DV 2018, section 2.2.

struct Unified {
  static constexpr const char* kName = "unified";
  static constexpr const char* kParamNames = "fx fy cx cy alpha";
  static constexpr LensExample kExamples[] = {
      {"TUM-VI cam0 as in extended_unified.h, with beta = 1",
       512,
       512,
       5,
       {191.147998, 191.131509, 255.458577, 257.381547, 0.6291060871161842}},
      {"a lens with a pole at 115 degrees: alpha below 1/2",
       640,
       480,
       5,
       {150.0, 151.0, 321.5, 238.25, 0.3}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 5; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& at) { return {at.With({0.5})}; }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckFocalParams(kName, kParamNames, params, num_params);
    CheckLensParam(kName, "alpha", params[4], 0.0, 1.0);
    return UnifiedSphere::MakeDomain(params, params[4], 1.0, angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    return UnifiedSphere::Project(domain, params, params[4], T(1.0), x, y, z, u, v);
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    return UnifiedSphere::Unproject(domain, params, params[4], 1.0, u, v, ray);
  }
};
