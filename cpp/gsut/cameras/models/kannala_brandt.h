// kannala_brandt: fisheye lens, an odd polynomial from angle to radius (OpenCV's fisheye, "equi").
//
//   h = sqrt(X^2 + Y^2), theta = atan2(h, Z)
//   rd = theta (1 + k1 theta^2 + k2 theta^4 + ...)
//   u = fx rd X/h + cx, v = fy rd Y/h + cy
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then any
// number of dimensionless coefficients from none (the equidistant fisheye) upwards; OpenCV has
// four. COLMAP's SIMPLE_RADIAL_FISHEYE, RADIAL_FISHEYE and OPENCV_FISHEYE, and Kalibr's
// pinhole-equi, are this lens. Domain: theta below the first root of d(rd)/d(theta), at most pi;
// points with Z <= 0 are seen. On the axis theta/h is taken by its series. Inverse: Newton on theta
// inside a bracket. Source: Kannala and Brandt, "A generic camera model and calibration method for
// conventional, wide-angle, and fish-eye lenses", PAMI 2006, radial part; OpenCV's documentation of
// fisheye.

struct KannalaBrandt {
  static constexpr const char* kName = "kannala_brandt";
  static constexpr const char* kParamNames = "fx fy cx cy k1 k2 k3 k4 ...";
  static constexpr LensExample kExamples[] = {
      {"TUM-VI cam0, calibration of the data set",
       512,
       512,
       8,
       {190.97847715128717, 190.9733070521226, 255.43170605935475, 257.3974428996504,
        0.0034823894022493434, 0.0007150348452162257, -0.0020532361418706202,
        0.00020293673591811182}},
      {"fisheye-stereo-calibration, left camera, solved with OpenCV from 29 boards (0.177 px)",
       960,
       600,
       8,
       {227.438047729, 226.607861938, 471.911667038, 306.257162773, 0.0253821095552,
        -0.025530288315, 0.0223000593257, -0.0079744051667}},
  };

  static bool AcceptsParams(int num_params) { return num_params >= 4; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& at) {
    return {at.With({0.0, 0.0, 0.0, 0.0})};
  }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckFocalParams(kName, kParamNames, params, num_params);
    return OddPolynomialDomain(params, num_params, angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int num_params, T x, T y, T z,
                      T* u, T* v) {
    const T square = x * x + y * y;
    const T square_z = z * z;
    const T h = Sqrt(square);
    // Near the axis, with q = (h/z)^2: theta/h = (1 - q/3)/z and theta^2 = q, both to less than
    // half a unit in the last place of a double.
    const auto near_axis = AndMask(z > T(0.0), square < T(1e-12) * square_z);
    const T ratio = square / square_z;
    const T angle = Atan2(h, z);
    const T angle_over_h = Select(near_axis, (T(1.0) - ratio * T(1.0 / 3.0)) / z, angle / h);
    const T square_angle = Select(near_axis, ratio, angle * angle);
    T factor(0.0);
    for (int i = num_params - 1; i >= 4; --i) factor = (factor + params[i]) * square_angle;
    const T scale = angle_over_h + angle_over_h * factor;
    const auto inside =
        AndMask(OrMask(near_axis, angle < T(domain.max_angle)), square < T(kInfinity));
    return AndMask(inside, ImagePlane::ToPixel(params, scale * x, scale * y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int num_params, double u,
                        double v, double* ray) {
    return UnprojectOddPolynomial(domain, params, num_params, u, v, ray);
  }
};
