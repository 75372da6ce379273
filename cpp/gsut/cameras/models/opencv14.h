// opencv14: radial-tangential distortion with 14 coefficients. Rational, thin prism and
// tilted sensor.
//
// Formula, domain and source: families/radial_tangential.h.
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then
// k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty,
// dimensionless, the last two in radians.
// Inverse: Newton, safeguarded (plane_map.h).

struct Opencv14 : RadialTangential<14> {
  static constexpr const char* kName = "opencv14";
  static constexpr const char* kParamNames =
      "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty";
  static constexpr LensExample kExamples[] = {
      {"fisheye-stereo-calibration, left camera, solved with OpenCV from 29 boards (0.171 px)",
       960,
       600,
       18,
       {229.263528403, 228.425904898, 472.483773609, 306.673431489, 0.46143934733, 0.0175239958931,
        0.00170837443751, -0.00061678347379, -0.000215613423242, 0.775148558802, 0.0907577801106,
        -0.000541010033447, 0.000841640474054, -8.30903332931e-05, -0.00272589279584,
        0.000108214964893, 0.000289252194869, 0.00161338980766}},
  };

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    return CheckedDomain(kName, kParamNames, params, num_params, angle_limit);
  }
};
