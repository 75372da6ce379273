// opencv4: radial-tangential distortion with 4 coefficients. The usual model of narrow lenses.
//
// Formula, domain and source: families/radial_tangential.h.
// COLMAP's SIMPLE_RADIAL, RADIAL and OPENCV, and Kalibr's pinhole-radtan, are this lens.
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then
// k1 k2 p1 p2, dimensionless.
// Inverse: Newton, safeguarded (plane_map.h); never OpenCV's fixed point, which diverges on wide
// lenses.

struct Opencv4 : RadialTangential<4> {
  static constexpr const char* kName = "opencv4";
  static constexpr const char* kParamNames = "fx fy cx cy k1 k2 p1 p2";
  static constexpr LensExample kExamples[] = {
      {"phone held upright, solved by COLMAP from its photographs",
       1080,
       1920,
       8,
       {1375.52, 1374.49, 554.558, 965.268, 0.0578421, -0.0805099, -0.000980296, 0.00015575}},
      {"EuRoC MAV cam0, factory calibration of the data set",
       752,
       480,
       8,
       {458.654, 457.296, 367.715, 248.875, -0.28340811, 0.07395907, 0.00019359, 1.76187114e-05}},
  };

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    return CheckedDomain(kName, kParamNames, params, num_params, angle_limit);
  }
};
