// equirectangular: the panorama that sees every direction, 360 x 180 degrees.
//
//   u = (atan2(X, Z) / (2 pi) + 1/2) W, v = (atan2(Y, hypot(X, Z)) / pi + 1/2) H
//
// Parameters: none; the image's width W and height H are the lens. The image's middle looks along
// the axis, its left and right edge (the seam) straight behind, its top and bottom row at the
// poles, straight up and down. COLMAP's EQUIRECTANGULAR is this lens. Domain: every direction but
// the two poles, whose image is a whole row. u lies in [0, W]: pixels beyond the seam are no other
// directions and have no ray. Inverse: closed. Source: the plate carree projection.

struct Equirectangular {
  static constexpr const char* kName = "equirectangular";
  static constexpr const char* kParamNames = "(none: the image's size is the lens)";
  static constexpr LensExample kExamples[] = {
      {"a 360-degree camera, stitched, small", 1024, 512, 0, {}},
  };
  // The size of the image is part of the lens: limits[0] is its width, limits[1] its height.
  static constexpr bool kTakesSize = true;

  static bool AcceptsParams(int num_params) { return num_params == 0; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& /*at*/) { return {{}}; }

  static LensDomain MakeDomain(const double* /*params*/, int /*num_params*/, double angle_limit,
                               int width, int height) {
    LensDomain domain = Globe::MakeDomain(angle_limit, 1, width, 0.0);
    domain.limits[0] = width;
    domain.limits[1] = height;
    return domain;
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* /*params*/, int /*num_params*/, T x, T y,
                      T z, T* u, T* v) {
    T longitude(0.0), latitude(0.0);
    const auto inside = Globe::Angles(domain, x, y, z, x, y, z, &longitude, &latitude);
    *u = (longitude * T(0.5 / kPi) + T(0.5)) * T(domain.limits[0]);
    *v = (latitude * T(1.0 / kPi) + T(0.5)) * T(domain.limits[1]);
    return inside;
  }

  static bool Unproject(const LensDomain& domain, const double* /*params*/, int /*num_params*/,
                        double u, double v, double* ray) {
    double x = 0.0, y = 0.0, z = 0.0;
    return Globe::Direction((u / domain.limits[0] - 0.5) * 2.0 * kPi,
                            (v / domain.limits[1] - 0.5) * kPi, &x, &y, &z) &&
           RayInCone(domain, x, y, z, ray);
  }

  static void Rescale(double* /*params*/, int /*num_params*/, double /*scale_x*/,
                      double /*scale_y*/) {}
};
