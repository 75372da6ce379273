// opencv12: radial-tangential distortion with 12 coefficients. Rational and thin prism.
//
// Formula, domain and source: families/radial_tangential.h.
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then
// k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4,
// dimensionless.
// Inverse: Newton, safeguarded (plane_map.h).

struct Opencv12 : RadialTangential<12> {
  static constexpr const char* kName = "opencv12";
  static constexpr const char* kParamNames = "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4";
  static constexpr LensExample kExamples[] = {
      {"fisheye-stereo-calibration, left camera, solved with OpenCV from 29 boards (0.171 px)",
       960,
       600,
       16,
       {229.24408647, 228.391294689, 472.839176371, 306.486460347, 0.440359442019, 0.011008056316,
        0.00177461491667, -0.000780989995393, -0.000389892299589, 0.754231018094, 0.0776660136951,
        -0.00153442468121, 0.000608914966296, -4.3389976423e-05, -0.00263666110914,
        8.39312268625e-05}},
  };

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    return CheckedDomain(kName, kParamNames, params, num_params, angle_limit);
  }
};
