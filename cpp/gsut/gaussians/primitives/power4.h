// power4: exp(-D^4 / 18), flatter inside and steeper at the rim than a Gaussian, which it meets at
// D = 3.
//
// With v = -log2(e) D^2 / 2, log2 f = -log2(e) D^4 / 18 = -(2 ln 2 / 9) v^2.
// Source: Moenne-Loccoz et al., "3D Gaussian ray tracing", 2024: the generalized Gaussian of degree
// 4, exp(-4.5 (D / 3)^4), its default kernel.

struct Power4 {
  static constexpr const char* kName = "power4";
  static constexpr bool kHasShape = false;
  static constexpr double kExampleShapes[] = {0.0};
  // 2 ln 2 / 9
  static constexpr double kFactor = 0.15403270679109895985;

  template <class T>
  static T Activate(T stored) {
    return stored;
  }
  template <class T>
  static T ActivationSlope(T /*stored*/) {
    return T(0.0);
  }
  template <class T>
  static T LogResponse(T v, T /*shape*/) {
    return T(-kFactor) * v * v;
  }
  template <class T>
  static T Slope(T v, T /*shape*/) {
    return T(-2.0 * kFactor) * v;
  }
  template <class T>
  static T ShapeSlope(T /*v*/, T /*shape*/) {
    return T(0.0);
  }
  template <class T>
  static T Invert(T log_response, T /*shape*/) {
    return -Sqrt(log_response * T(-1.0 / kFactor));
  }
};
