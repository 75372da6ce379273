// brown_fisheye: equidistant fisheye of photogrammetry, with tangential terms and a skewed sensor.
//
// (x, y) = theta (X, Y) / |(X, Y)|, theta the angle from the axis; distortion, parameters and
// source: families/brown.h. Metashape's fisheye camera is this lens; thin_prism_fisheye is it
// without skew and with thin prisms. (0.5, 0.5) is the centre of the top-left pixel. Domain: up to
// the first circle on which the map folds (plane_inverses.h); points with Z <= 0 are seen. Inverse:
// Newton, safeguarded (plane_map.h).

struct BrownFisheye : Brown {
  static constexpr const char* kName = "brown_fisheye";
  static constexpr LensExample kExamples[] = {
      {"TUM-VI cam0, the lens of kannala_brandt.h on a skewed sensor, slightly off its axis",
       512,
       512,
       11,
       {190.97847715128717, 190.9733070521226, 255.43170605935475, 257.3974428996504, 0.12,
        0.0034823894022493434, 0.0007150348452162257, -0.0020532361418706202,
        0.00020293673591811182, -0.00031, 0.00042}},
  };

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckParams(kName, params, num_params);
    return PlaneChartDomain(PlaneChart::kEquidistant, params, Map(params), angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    T plane_x(0.0), plane_y(0.0), distorted_x(0.0), distorted_y(0.0);
    const auto inside = EquidistantPlane::FromPoint(domain, x, y, z, &plane_x, &plane_y);
    Distort(params, plane_x, plane_y, &distorted_x, &distorted_y);
    return AndMask(inside, ImagePlane::ToPixel(params, distorted_x, distorted_y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    return UnprojectPlaneChart(PlaneChart::kEquidistant, domain, params, Map(params), u, v, ray);
  }
};
