// ftheta: NVIDIA's fisheye; polynomials from pixel distance to angle and back, one of them exact.
//
//   A(theta) = A0 + A1 theta + ... + A5 theta^5 in pixels, B(r) = B0 + B1 r + ... + B5 r^5 in
//   radians; r = A(theta) with reference 1, r the solution of B(r) = theta with reference 0;
//   (x, y) = r (X, Y) / |(X, Y)|, u = c x + d y + cx, v = e x + y + cy
//
// Parameters: cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel; reference, 0 or 1;
// B0..B5, A0..A5; max_angle, the angle in radians up to which the polynomials hold; c d e. The
// polynomial that is not the reference only starts the inverse of the other. B0 and A0 must be 0.
// Domain: theta below max_angle and the first fold of the exact polynomial; points with Z <= 0 are
// seen. limits[0] is the largest r. Inverse: Newton inside a bracket (reference 1), closed
// (reference 0). With reference 0 the projection is kSteps Newton steps from A; MakeDomain refuses
// polynomials that they do not bring within 1e-11 of the solution. Source: NVIDIA DriveWorks'
// documentation of its f-theta camera model; the parameters are those of its FThetaCamera in
// gsplat.

struct Ftheta {
  static constexpr const char* kName = "ftheta";
  static constexpr const char* kParamNames =
      "cx cy reference B0 B1 B2 B3 B4 B5 A0 A1 A2 A3 A4 A5 max_angle c d e";
  static constexpr LensExample kExamples[] = {
      {"TUM-VI cam0, polynomials fitted to the lens of kannala_brandt.h (0.2 px); angle to pixel",
       512,
       512,
       19,
       {255.9317, 257.8974, 1.0, 0.0, 0.00525795149951, -8.10971182831e-07, 9.44964342963e-09,
        -5.13926340263e-11, 1.01263493992e-13, 0.0, 190.892671928, 0.899676946274, -2.4422029589,
        4.489445805, -2.4117488308, 1.75, 1.0000237, 0.0, 0.0}},
      {"the same, pixel to angle, with a sheared sensor",
       512,
       512,
       19,
       {255.9317, 257.8974, 0.0, 0.0, 0.00525795149951, -8.10971182831e-07, 9.44964342963e-09,
        -5.13926340263e-11, 1.01263493992e-13, 0.0, 190.892671928, 0.899676946274, -2.4422029589,
        4.489445805, -2.4117488308, 1.75, 1.0003, 0.0004, -0.0002}},
  };
  // Places of parameters: which polynomial is the reference, the six coefficients from pixels to
  // angles, the six back, the largest angle and the three of the linear map.
  static constexpr int kReference = 2;
  static constexpr int kB = 3;
  static constexpr int kA = 9;
  static constexpr int kMaxAngle = 15;
  static constexpr int kLinear = 16;
  static constexpr int kDegree = 5;
  static constexpr int kSteps = 6;

  static constexpr int kChoices[] = {kReference, kB, kA};
  static constexpr int kFitHeld[] = {2, 3, 4, 5, 6, 7, 8, 9, 15};  // B only starts the inverse
  static constexpr double kBeyond = 1e-3;  // radians that a fit leaves beyond the farthest point

  static bool AcceptsParams(int num_params) { return num_params == 19; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& at) {
    return {{at.cx, at.cy, 1.0, 0.0, 1.0 / at.fy, 0.0, 0.0, 0.0, 0.0, 0.0, at.fy, 0.0, 0.0, 0.0,
             0.0, std::min(at.max_angle + kBeyond, kPi), at.fx / at.fy, 0.0, 0.0}};
  }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckParams(params, num_params);
    return FthetaDomain(params, angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    constexpr double kSmallest = 1e-30;  // keeps the root's derivative finite on the axis
    T plane_x(0.0), plane_y(0.0);
    const auto inside = EquidistantPlane::FromPoint(domain, x, y, z, &plane_x, &plane_y);
    const T theta = Sqrt(Max(plane_x * plane_x + plane_y * plane_y, T(kSmallest)));
    const T gain = Gain(params, theta);
    const T px = gain * plane_x, py = gain * plane_y;
    *u = params[kLinear] * px + params[kLinear + 1] * py + params[0];
    *v = params[kLinear + 2] * px + py + params[1];
    return AndMask(inside, AndMask(Abs(*u) < T(kMaxPixel), Abs(*v) < T(kMaxPixel)));
  }

  // r / theta, which is smooth at the axis.
  template <class T>
  static T Gain(const T* params, T theta) {
    const T by_a = Quotient(params + kA, theta);
    T gain = by_a;
    // Solves gain B(r) / r = 1 with r = theta gain.
    for (int step = 0; step < kSteps; ++step) {
      const T r = theta * gain;
      gain = gain - (gain * Quotient(params + kB, r) - T(1.0)) / Slope(params + kB, r);
    }
    return Select(params[kReference] > T(0.5), by_a, gain);
  }

  // p(t) / t for p without constant term.
  template <class T>
  static T Quotient(const T* p, T t) {
    T sum = p[kDegree];
    for (int i = kDegree - 1; i >= 1; --i) sum = sum * t + p[i];
    return sum;
  }

  // p'(t).
  template <class T>
  static T Slope(const T* p, T t) {
    T sum = T(1.0 * kDegree) * p[kDegree];
    for (int i = kDegree - 1; i >= 1; --i) sum = sum * t + T(1.0 * i) * p[i];
    return sum;
  }

  static void CheckParams(const double* params, int num_params) {
    const double largest = 0.5 * kMaxPixel;
    for (int i = 0; i < num_params; ++i) {
      CheckLensParam(kName,
                     i == kMaxAngle ? "max_angle"
                     : i < 2        ? "cx, cy"
                                    : "a coefficient",
                     params[i], -largest, largest);
    }
    if (params[kReference] != 1.0) CheckLensParam(kName, "reference (0 or 1)", params[2], 0.0, 0.0);
    CheckLensParam(kName, "A0", params[kA], 0.0, 0.0);
    CheckLensParam(kName, "B0", params[kB], 0.0, 0.0);
    CheckLensParam(kName, "A1", params[kA + 1], 1e-3, largest);
    CheckLensParam(kName, "B1", params[kB + 1], 1.0 / largest, 1e3);
    CheckLensParam(kName, "max_angle", params[kMaxAngle], 1e-6, kPi);
    const double* linear = params + kLinear;
    CheckLensParam(kName, "c - d e (the area)", linear[0] - linear[1] * linear[2], 1e-3, 1e3);
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    if (!(std::abs(u) < kMaxPixel && std::abs(v) < kMaxPixel)) return false;
    const double c = params[kLinear], d = params[kLinear + 1], e = params[kLinear + 2];
    const double du = u - params[0], dv = v - params[1];
    const double x = (du - d * dv) / (c - d * e), y = (c * dv - e * du) / (c - d * e);
    return UnprojectFtheta(domain, params, x, y, ray);
  }

  static void Rescale(double* params, int /*num_params*/, double scale_x, double scale_y) {
    params[0] *= scale_x;
    params[1] *= scale_y;
    // Distances are those of rows.
    double power = 1.0;
    for (int i = 0; i <= kDegree; ++i, power *= scale_y) {
      params[kB + i] /= power;
      params[kA + i] *= scale_y;
    }
    params[kLinear] *= scale_x / scale_y;
    params[kLinear + 1] *= scale_x / scale_y;
  }
};
