// fov: the field-of-view model of wide lenses, one parameter beyond the pinhole.
//
//   rd = atan2(2 R tan(omega / 2), Z) / omega, R = |(X, Y)|; u = fx rd X / R + cx, v likewise.
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then omega,
// the angle of view of the ideal lens, radians in (0, pi). COLMAP's FOV and Kalibr's fov are this
// lens; they stop at Z = 0, where the arctangent of the source ends, while here it goes on smoothly
// to every direction but straight behind. Inverse: closed. Source: Devernay and Faugeras, "Straight
// lines have to be straight", MVA 2001.

struct Fov {
  static constexpr const char* kName = "fov";
  static constexpr const char* kParamNames = "fx fy cx cy omega";
  static constexpr LensExample kExamples[] = {
      {"TUM monoVO, wide-angle lens, calibration of the data set",
       1280,
       1024,
       5,
       {446.91584, 447.071232, 631.2192, 510.997504, 0.933271}},
  };

  static bool AcceptsParams(int num_params) { return num_params == 5; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& at) { return {at.With({0.5})}; }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    constexpr double kSmallest = 1e-6;       // below, the lens is a pinhole to 1e-13
    constexpr double kLargest = kPi - 1e-6;  // above, its field has shrunk to nothing
    CheckFocalParams(kName, kParamNames, params, num_params);
    CheckLensParam(kName, "omega", params[4], kSmallest, kLargest);
    const double omega = params[4];
    const double gain = 2.0 * std::tan(0.5 * omega);
    return RadialDomain(params, kPi, angle_limit, [omega, gain](double angle) {
      return std::atan2(gain * std::sin(angle), std::cos(angle)) / omega;
    });
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T omega = params[4];
    const T gain = T(2.0) * Tan(T(0.5) * omega);
    const T square = x * x + y * y;
    const T square_z = z * z;
    const T h = Sqrt(square);
    const auto inside = Cone::Contains(domain, h, z, Sqrt(square + square_z));
    // atan(t) / t = 1 - t^2 / 3 for t = gain h / z below 1e-6, to half a unit in the last place.
    const T ratio = gain * gain * square / square_z;
    const auto near_axis = AndMask(z > T(0.0), ratio < T(1e-12));
    const T series = (gain - gain * ratio * T(1.0 / 3.0)) / z;
    const T scale = Select(near_axis, series, Atan2(gain * h, z) / h) / omega;
    return AndMask(inside, ImagePlane::ToPixel(params, scale * x, scale * y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    double x = 0.0, y = 0.0;
    if (!FromPixel(params, u, v, &x, &y)) return false;
    const double radius = std::hypot(x, y);
    if (!(radius < domain.max_radius)) return false;
    const double omega = params[4];
    const double gain = 2.0 * std::tan(0.5 * omega);
    const double sine_over_radius = radius > 0.0 ? std::sin(omega * radius) / radius : omega;
    return RayInCone(domain, sine_over_radius * x, sine_over_radius * y,
                     gain * std::cos(omega * radius), ray);
  }
};
