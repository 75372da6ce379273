// brown_conrady: perspective lens of photogrammetry, with four radial terms and a skewed sensor.
//
// (x, y) = (X, Y) / Z; distortion, parameters and source: families/brown.h. Metashape's frame
// camera is this lens; opencv5 is it without k4 and skew. (0.5, 0.5) is the centre of the top-left
// pixel. Domain: Z > 0 and up to the first circle on which the map folds (plane_inverses.h).
// Inverse: Newton, safeguarded (plane_map.h).

struct BrownConrady : Brown {
  static constexpr const char* kName = "brown_conrady";
  static constexpr LensExample kExamples[] = {
      {"a video camera, calibration by Metashape",
       1920,
       1080,
       11,
       {1430.15016509976, 1430.15016509976, 935.8657939824017, 557.5452248329602, -4.25145544487403,
        -0.118322055927498, 0.293632083518507, 0.0, 0.0, 0.00182154893322038,
        0.000330080086304322}},
      {"the phone of opencv4.h with a fourth radial term and unequal pixels",
       1080,
       1920,
       11,
       {1375.52, 1374.49, 554.558, 965.268, 0.31, 0.0578421, -0.0805099, 0.021, -0.009,
        -0.000980296, 0.00015575}},
  };

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckParams(kName, params, num_params);
    return PlaneChartDomain(PlaneChart::kGnomonic, params, Map(params), angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T plane_x = x / z, plane_y = y / z;
    const T square = plane_x * plane_x + plane_y * plane_y;
    const auto inside = AndMask(z > T(0.0), square < T(domain.limits[0]));
    T distorted_x(0.0), distorted_y(0.0);
    Distort(params, plane_x, plane_y, &distorted_x, &distorted_y);
    return AndMask(inside, ImagePlane::ToPixel(params, distorted_x, distorted_y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    return UnprojectPlaneChart(PlaneChart::kGnomonic, domain, params, Map(params), u, v, ray);
  }
};
