// beta: (1 - D^2 / (2 b))^b, 0 from D^2 = 2 b on: a ball with a soft rim for small b, exp(-D^2 / 2)
// for large ones.
//
// Shape: b = 1/2 + 7/2 exp(x), stored as x; x = 0 gives b = 4. The radius sqrt(2 b) grows with b,
// so that the response at the centre bends as a Gaussian's whatever b is, and shape and scales are
// learnt apart. Over a footprint the square of the gradient to D^2 goes as (1 - D^2 / (2 b))^(2 b -
// 2), whose integral is finite for b > 1/2. x counts up to kMostStored: b is 1412 there, and
// float cannot distinguish the response from a Gaussian's.
// With v = -log2(e) D^2 / 2 and y = 1 - D^2 / (2 b) = 1 + v ln 2 / b: log2 f = b log2 y.
// Source: Liu et al., "Deformable Beta splatting", 2025, whose radius does not depend on b.

struct Beta {
  static constexpr const char* kName = "beta";
  static constexpr bool kHasShape = true;
  static constexpr double kExampleShapes[] = {-3.0, -1.0, 0.0, 1.5, 5.0};
  static constexpr double kLn2 = 0.69314718055994530942;
  static constexpr double kLog2E = 1.44269504088896340736;
  static constexpr double kLeastB = 0.5;
  static constexpr double kSpan = 3.5;
  static constexpr double kMostStored = 6.0;
  // Of y: a logarithm of less says nothing, and misses lie beyond.
  static constexpr double kLeastY = 1e-30;

  template <class T>
  static T Activate(T stored) {
    return T(kLeastB) + T(kSpan) * Exp2(T(kLog2E) * Min(stored, T(kMostStored)));
  }
  template <class T>
  static T ActivationSlope(T stored) {
    return Select(stored < T(kMostStored), Activate(stored) - T(kLeastB), T(0.0));
  }
  template <class T>
  static T Rest(T v, T shape) {
    return Max(T(1.0) + v * T(kLn2) / shape, T(kLeastY));
  }
  template <class T>
  static T LogResponse(T v, T shape) {
    return shape * Log2(Rest(v, shape));
  }
  template <class T>
  static T Slope(T v, T shape) {
    return T(1.0) / Rest(v, shape);
  }
  template <class T>
  static T ShapeSlope(T v, T shape) {
    const T y = Rest(v, shape);
    return Log2(y) - v / (shape * y);
  }
  template <class T>
  static T Invert(T log_response, T shape) {
    return shape * T(kLog2E) * (Exp2(log_response / shape) - T(1.0));
  }
};
