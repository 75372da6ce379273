// latlon: a panorama lying on its side; columns are latitudes, rows longitudes.
//
//   u = fx atan2(X, hypot(Y, Z)) + cx, v = fy atan2(Y, Z) + cy
//
// Parameters: fx fy in pixels per radian, cx cy in pixels; (0.5, 0.5) is the centre of the top-left
// pixel. mrcal's LENSMODEL_LATLON is this lens. Domain: every direction but the two poles, straight
// left and right. v - cy lies in [-pi fy, pi fy]: pixels beyond the seam have no ray. Inverse:
// closed. Source: mrcal's documentation of its lens models.

struct Latlon {
  static constexpr const char* kName = "latlon";
  static constexpr const char* kParamNames = "fx fy cx cy";
  static constexpr LensExample kExamples[] = {
      {"a whole panorama of 1 degree a pixel, the seam two pixels off the edge",
       180,
       360,
       4,
       {57.29577951308232, 57.29577951308232, 90.0, 182.0}},
      {"a rectified pair of fisheyes, as mrcal's stereo matching takes it",
       400,
       300,
       4,
       {150.0, 151.0, 200.5, 149.5}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 4; }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckFocalParams(kName, kParamNames, params, num_params);
    CheckLensParam(kName, "fx", params[0], 0.0, kLargestFocal);
    CheckLensParam(kName, "fy", params[1], 0.0, kLargestFocal);
    return Globe::MakeDomain(angle_limit, 0, 0.0, 2.0 * kPi * params[1]);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    T longitude(0.0), latitude(0.0);
    const auto inside = Globe::Angles(domain, y, x, z, x, y, z, &longitude, &latitude);
    return AndMask(inside, ImagePlane::ToPixel(params, latitude, longitude, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    double longitude = 0.0, latitude = 0.0, x = 0.0, y = 0.0, z = 0.0;
    return FromPixel(params, u, v, &latitude, &longitude) &&
           Globe::Direction(longitude, latitude, &y, &x, &z) && RayInCone(domain, x, y, z, ray);
  }

  static constexpr double kLargestFocal = 1e8;  // pixels per radian: pixels stay below kMaxPixel
};
