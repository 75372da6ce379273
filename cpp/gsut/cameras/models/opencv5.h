// opencv5: radial-tangential distortion with 5 coefficients. OpenCV's default.
//
// Formula, domain and source: families/radial_tangential.h.
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then
// k1 k2 p1 p2 k3, dimensionless.
// Inverse: Newton, safeguarded (plane_map.h); never OpenCV's fixed point, which diverges on wide
// lenses.

struct Opencv5 : RadialTangential<5> {
  static constexpr const char* kName = "opencv5";
  static constexpr const char* kParamNames = "fx fy cx cy k1 k2 p1 p2 k3";
  static constexpr LensExample kExamples[] = {
      {"TUM RGB-D freiburg1 colour camera, calibration of the data set",
       640,
       480,
       9,
       {517.306408, 516.469215, 319.14304, 255.813989, 0.262383, -0.953104, -0.005358, 0.002628,
        1.163314}},
  };

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    return CheckedDomain(kName, kParamNames, params, num_params, angle_limit);
  }
};
