// cahvore: cahvor for fisheye lenses, with an entrance pupil that moves along the optical axis.
//
//   o = (sin(alpha) cos(beta), sin(beta), cos(alpha) cos(beta)), w = P.o, l = |P - w o|
//   theta: w sin(theta) - l cos(theta) = (theta - sin(theta)) (e0 + e1 theta^2 + e2 theta^4)
//   chi = theta, tan(L theta) / L for L > 0, sin(L theta) / L for L < 0
//   P' = (l / chi) o + (1 + r0 + r1 chi^2 + r2 chi^4) (P - w o), u = fx X'/Z' + cx, ...
//
// Parameters: fx fy cx cy in pixels; (0.5, 0.5) is the centre of the top-left pixel. Then alpha
// beta, radians; r0 r1 r2, dimensionless; e0 e1 e2, in the length unit of the points; the linearity
// L, 1 for a lens with perspective, 0 for an equidistant one. mrcal's LENSMODEL_CAHVORE is this
// lens. A ray at the angle theta from o starts at (theta / sin(theta) - 1) (e0 + e1 theta^2 + e2
// theta^4) on the axis o: rays do not meet. Domain: theta below |L| theta = 90 degrees and below
// the first fold of chi (1 + ...), cut at the angle limit; Z' > 0. The angle is found by Newton,
// the inverse by Newton inside a bracket (special_inverses.h). Source: Gennery, "Generalized camera
// calibration including fish-eye lenses", IJCV 2006; mrcal's documentation.

struct Cahvore {
  static constexpr const char* kName = "cahvore";
  static constexpr const char* kParamNames = "fx fy cx cy alpha beta r0 r1 r2 e0 e1 e2 linearity";
  static constexpr LensExample kExamples[] = {
      {"a rover's hazard camera: 120 degrees across, its pupil moves by 2 mm (in metres)",
       640,
       480,
       13,
       {330.0, 329.0, 320.5, 242.0, 0.011, -0.007, 0.0004, -0.012, 0.003, 0.004, -0.002, 0.0005,
        0.37}},
      {"a fisheye: 150 degrees across, nearly equidistant (in metres)",
       512,
       512,
       13,
       {190.0, 190.5, 256.0, 254.5, -0.006, 0.004, 0.0, -0.02, 0.001, 0.006, 0.001, 0.0, -0.1}},
  };
  static constexpr bool kHasOrigins = true;

  static constexpr int kFitNear[] = {9, 10, 11};  // e0 e1 e2

  static bool AcceptsParams(int num_params) { return num_params == 13; }

  static std::vector<std::vector<double>> FitStarts(const FitAxis& at) {
    return {at.With({0, 0, 0, 0, 0, 0, 0, 0, 0.5}), at.With({0, 0, 0, 0, 0, 0, 0, 0, -0.5})};
  }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckFocalParams(kName, kParamNames, params, num_params);
    return PupilChartDomain(params, angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T one(1.0), zero(0.0);
    const T cos_beta = Cos(params[5]);
    const T axis[3] = {Sin(params[4]) * cos_beta, Sin(params[5]), Cos(params[4]) * cos_beta};
    const T along = x * axis[0] + y * axis[1] + z * axis[2];
    const T off[3] = {x - along * axis[0], y - along * axis[1], z - along * axis[2]};
    const T square = off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
    // So near the axis that the pupil's motion and the distortion are below rounding.
    const auto on_axis = AndMask(along > zero, square <= T(1e-16) * along * along);
    const T l = Sqrt(Select(on_axis, one, square));
    T theta = Select(on_axis, one, Atan2(l, along));
    T step = zero;
    constexpr int kSteps = 10;  // from the direction of the point: four suffice at a pupil's length
    for (int i = 0; i < kSteps; ++i) {
      const T sine = Sin(theta), cosine = Cos(theta), theta2 = theta * theta;
      const T pupil = params[9] + theta2 * (params[10] + theta2 * params[11]);
      const T slope = theta * (T(2.0) * params[10] + T(4.0) * theta2 * params[11]);
      const T late = theta - sine;
      step = (along * sine - l * cosine - late * pupil) /
             (along * cosine + l * sine - (one - cosine) * pupil - late * slope);
      theta = theta - step;
    }
    const T linearity = params[12];
    const auto is_tangent = linearity > zero, is_sine = linearity < zero;
    const T divisor = Select(OrMask(is_tangent, is_sine), linearity, one);
    const T turned = linearity * theta;
    const T chi =
        Select(is_tangent, Tan(turned) / divisor, Select(is_sine, Sin(turned) / divisor, theta));
    const T chi2 = Select(on_axis, zero, chi * chi);
    const T factor = one + params[6] + chi2 * (params[7] + chi2 * params[8]);
    const T forward = Select(on_axis, along, l / chi);
    const T depth = forward * axis[2] + factor * off[2];
    const auto in_domain = AndMask(AndMask(theta > zero, theta < T(domain.limits[0])),
                                   Abs(step) < T(1e-5));  // converged: the next is its square
    const auto inside = AndMask(OrMask(on_axis, in_domain), depth > zero);
    return AndMask(inside,
                   ImagePlane::ToPixel(params, (forward * axis[0] + factor * off[0]) / depth,
                                       (forward * axis[1] + factor * off[1]) / depth, u, v));
  }

  static bool UnprojectLine(const LensDomain& domain, const double* params, int /*num_params*/,
                            double u, double v, double* origin, double* ray) {
    return UnprojectPupilChart(domain, params, u, v, origin, ray);
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    double origin[3];
    return UnprojectPupilChart(domain, params, u, v, origin, ray);
  }
};
