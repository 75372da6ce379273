// pinhole: straight lines stay straight.
//
//   u = fx X/Z + cx, v = fy Y/Z + cy
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel.
// Domain: Z > 0, up to 90 degrees less 2e-9 fx rad, where pixels reach 5e8. limits[0]: the squared
// tangent of the largest angle. Inverse: closed. Source: central projection, as in any textbook.

struct Pinhole {
  static constexpr const char* kName = "pinhole";
  static constexpr const char* kParamNames = "fx fy cx cy";
  static constexpr LensExample kExamples[] = {
      {"KITTI odometry, left grey camera after rectification, sequence 00",
       1241,
       376,
       4,
       {718.856, 718.856, 607.6928, 185.7157}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 4; }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckFocalParams(kName, kParamNames, params, num_params);
    return PinholeDomain(params, angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T plane_x = x / z;
    const T plane_y = y / z;
    const T square = plane_x * plane_x + plane_y * plane_y;
    const auto inside = AndMask(z > T(0.0), square < T(domain.limits[0]));
    return AndMask(inside, ImagePlane::ToPixel(params, plane_x, plane_y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    return UnprojectPinhole(domain, params, u, v, ray);
  }
};
