// opencv8: radial-tangential distortion with 8 coefficients. The rational model.
//
// Formula, domain and source: families/radial_tangential.h.
// Fitted to a fisheye it often has a pole inside the image (LENSMODEL_OPENCV8 in mrcal, FULL_OPENCV
// in COLMAP are this lens): the domain ends there.
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then
// k1 k2 p1 p2 k3 k4 k5 k6, dimensionless.
// Inverse: Newton, safeguarded (plane_map.h); never OpenCV's fixed point, which diverges on wide
// lenses.

struct Opencv8 : RadialTangential<8> {
  static constexpr const char* kName = "opencv8";
  static constexpr const char* kParamNames = "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6";
  static constexpr LensExample kExamples[] = {
      {"mrcal's tour, camera 0, solved by mrcal",
       4000,
       2200,
       12,
       {1761.181055, 1761.250444, 1966.206996, 1088.018797, -0.01266096516, 0.03590794372,
        -0.0002547045941, 0.0005275929652, 0.01968883397, 0.01482863541, -0.0562239888,
        0.0500223357}},
      {"mrcal's Figueroa overpass, solved by mrcal",
       6016,
       4016,
       12,
       {2073.872915, 2077.452267, 3005.186823, 1997.877253, 0.4791613797, 0.0266824914,
        4.398264387e-05, -1.180073913e-05, 8.959722542e-05, 0.7666912469, 0.09633561231,
        0.001407513313}},
      {"fisheye-stereo-calibration, left camera, solved with OpenCV from 29 boards (0.173 px)",
       960,
       600,
       12,
       {228.996689659, 228.157820929, 473.25956332, 304.853715568, 0.353117793557, -0.0113757058248,
        0.000617771623678, -0.00059766226152, -0.000694523563845, 0.66620896346, 0.0293881727574,
        -0.00402547358406}},
  };

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    return CheckedDomain(kName, kParamNames, params, num_params, angle_limit);
  }
};
