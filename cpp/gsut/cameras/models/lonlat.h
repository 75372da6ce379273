// lonlat: a panorama or a part of one; columns are longitudes, rows latitudes.
//
//   u = fx atan2(X, Z) + cx, v = fy atan2(Y, hypot(X, Z)) + cy
//
// Parameters: fx fy in pixels per radian, cx cy in pixels; (0.5, 0.5) is the centre of the top-left
// pixel. mrcal's LENSMODEL_LONLAT is this lens. Domain: every direction but the two poles, straight
// up and down. u - cx lies in [-pi fx, pi fx]: pixels beyond the seam have no ray. Inverse: closed.
// Source: mrcal's documentation of its lens models.

struct Lonlat {
  static constexpr const char* kName = "lonlat";
  static constexpr const char* kParamNames = "fx fy cx cy";
  static constexpr LensExample kExamples[] = {
      {"a whole panorama of 1 degree a pixel, the seam two pixels off the edge",
       360,
       180,
       4,
       {57.29577951308232, 57.29577951308232, 182.0, 90.0}},
      {"a strip of 120 x 40 degrees", 600, 200, 4, {286.4788975, 286.0, 300.25, 101.5}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 4; }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckFocalParams(kName, kParamNames, params, num_params);
    CheckLensParam(kName, "fx", params[0], 0.0, kLargestFocal);
    CheckLensParam(kName, "fy", params[1], 0.0, kLargestFocal);
    return Globe::MakeDomain(angle_limit, 1, 2.0 * kPi * params[0], 0.0);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    T longitude(0.0), latitude(0.0);
    const auto inside = Globe::Angles(domain, x, y, z, x, y, z, &longitude, &latitude);
    return AndMask(inside, ImagePlane::ToPixel(params, longitude, latitude, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    double longitude = 0.0, latitude = 0.0, x = 0.0, y = 0.0, z = 0.0;
    return FromPixel(params, u, v, &longitude, &latitude) &&
           Globe::Direction(longitude, latitude, &x, &y, &z) && RayInCone(domain, x, y, z, ray);
  }

  static constexpr double kLargestFocal = 1e8;  // pixels per radian: pixels stay below kMaxPixel
};
