// ocam: Scaramuzza's fisheye; a polynomial from the distance in pixels to the depth of the ray.
//
//   u = c x + d y + cx, v = e x + y + cy; rho = |(x, y)|;
//   the ray is (x, y, a0 + a2 rho^2 + a3 rho^3 + ...)
//
// Parameters: cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then c d e, the
// shape of a pixel and the skew; a0 (the focal length, in rows), a2, a3 ... in any number, in
// pixels to the power of 1 - k. There is no a1: the lens is smooth on its axis. MATLAB's
// fisheyeIntrinsics is this lens; OCamCalib's is too, with rows first and looking along -z, which
// its reader turns. Domain: rho up to the first fold, at most kFarthest a0, as far as the inverse
// is found; points with Z <= 0 are seen. Pixel to ray is closed and is the model; ray to pixel is
// kSteps Newton steps from an odd polynomial of the angle that MakeDomain fits (limits[0..2]), so
// that nothing rests on the approximate inverse that OCamCalib's files carry. Source: Scaramuzza,
// Martinelli and Siegwart, "A toolbox for easily calibrating omnidirectional cameras", IROS 2006.

struct Ocam {
  static constexpr const char* kName = "ocam";
  static constexpr const char* kParamNames = "cx cy c d e a0 a2 a3 a4 ...";
  static constexpr LensExample kExamples[] = {
      {"a fisheye of 848 x 800, solved by OCamCalib, published with its polynomials",
       848,
       800,
       9,
       {418.020087, 387.621004, 1.0023806540533768, -9.622854278912417e-05, -0.00046710938478887356,
        289.0477772375, -0.00177793459466232, 4.80256308519729e-06, -1.02539157717593e-08}},
      {"a fisheye of 1280 x 960, likewise",
       1280,
       960,
       9,
       {658.320886, 460.042917, 1.0001060112371911, -0.00014601547764062992,
        -0.00010401102516866788, 300.096686379, -0.00140133054103735, 1.61272988061406e-06,
        -4.17197554760015e-09}},
  };
  static constexpr int kLinear = 2;      // where c d e begin
  static constexpr int kPolynomial = 5;  // where a0 a2 a3 ... begin
  static constexpr int kSteps = 6;
  static constexpr double kFarthest = 16.0;  // of a0: 86 degrees of a lens without distortion

  static bool AcceptsParams(int num_params) { return num_params >= 6; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& at) {
    return {{at.cx, at.cy, at.fx / at.fy, 0.0, 0.0, at.fy, 0.0, 0.0, 0.0}};
  }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckParams(params, num_params);
    return OcamDomain(params, num_params, angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int num_params, T x, T y, T z,
                      T* u, T* v) {
    constexpr double kSmallest = 1e-30;  // keeps the root's derivative finite on the axis
    T plane_x(0.0), plane_y(0.0);
    const auto inside = EquidistantPlane::FromPoint(domain, x, y, z, &plane_x, &plane_y);
    const T theta = Sqrt(Max(plane_x * plane_x + plane_y * plane_y, T(kSmallest)));
    const T gain = Gain(domain, params, num_params, theta);
    const T px = gain * plane_x, py = gain * plane_y;
    *u = params[kLinear] * px + params[kLinear + 1] * py + params[0];
    *v = params[kLinear + 2] * px + py + params[1];
    return AndMask(inside, AndMask(Abs(*u) < T(kMaxPixel), Abs(*v) < T(kMaxPixel)));
  }

  // rho / theta, which is smooth at the axis: solves gain cos(theta) = depth(rho) sin(theta) /
  // theta with rho = theta gain.
  template <class T>
  static T Gain(const LensDomain& domain, const T* params, int num_params, T theta) {
    const T square = theta * theta;
    const T cosine = Cos(theta), sine = Sin(theta);
    T gain = params[kPolynomial] *
             (T(1.0) + square * (T(domain.limits[0]) +
                                 square * (T(domain.limits[1]) + square * T(domain.limits[2]))));
    for (int step = 0; step < kSteps; ++step) {
      T slope(0.0);
      const T depth = Depth(params, num_params, theta * gain, &slope);
      gain = gain - (gain * cosine - depth * sine / theta) / (cosine - slope * sine);
    }
    return gain;
  }

  // a0 + a2 rho^2 + ... and its derivative.
  template <class T>
  static T Depth(const T* params, int num_params, T rho, T* slope) {
    T sum(0.0), derivative(0.0);
    for (int i = num_params - 1; i > kPolynomial; --i) {
      sum = sum * rho + params[i];
      derivative = derivative * rho + T(1.0 * (i - kPolynomial + 1)) * params[i];
    }
    *slope = derivative * rho;
    return params[kPolynomial] + sum * rho * rho;
  }

  static void CheckParams(const double* params, int num_params) {
    const double largest = 0.5 * kMaxPixel;
    for (int i = 0; i < num_params; ++i) {
      CheckLensParam(kName, i < 2 ? "cx, cy" : "a coefficient", params[i], -largest, largest);
    }
    CheckLensParam(kName, "a0", params[kPolynomial], 1e-3, largest);
    const double* linear = params + kLinear;
    CheckLensParam(kName, "c - d e (the area)", linear[0] - linear[1] * linear[2], 1e-3, 1e3);
  }

  static bool Unproject(const LensDomain& domain, const double* params, int num_params, double u,
                        double v, double* ray) {
    if (!(std::abs(u) < kMaxPixel && std::abs(v) < kMaxPixel)) return false;
    const double c = params[kLinear], d = params[kLinear + 1], e = params[kLinear + 2];
    const double du = u - params[0], dv = v - params[1];
    const double x = (du - d * dv) / (c - d * e), y = (c * dv - e * du) / (c - d * e);
    const double rho = std::hypot(x, y);
    double slope = 0.0;
    return rho < domain.max_radius &&
           RayInCone(domain, x, y, Depth(params, num_params, rho, &slope), ray);
  }

  static void Rescale(double* params, int num_params, double scale_x, double scale_y) {
    params[0] *= scale_x;
    params[1] *= scale_y;
    params[kLinear] *= scale_x / scale_y;
    params[kLinear + 1] *= scale_x / scale_y;
    // Distances are those of rows.
    params[kPolynomial] *= scale_y;
    double power = scale_y;
    for (int i = kPolynomial + 1; i < num_params; ++i, power *= scale_y) params[i] /= power;
  }
};
