// triangle: flat, (1 - g / r)^b with g growing from 0 at the centre to r at the outline, 0 beyond.
//
// With (x, y) where the ray meets the plane of the first two axes, in units of their scales, the
// gauge is that of an equilateral triangle, g = max(-2 y, sqrt(3) |x| + y): the corners of g = 1
// lie on the unit circle, one of them at (0, 1). Two scales and a rotation make every isosceles
// triangle of it, and no other. Shape: b = 1/2 + 1/2 exp(x), stored as x; x = 0 gives b = 1, where
// the response falls linearly; near 1/2 the outline is sharp. r^2 = 2/3 (b + 3) (b + 4) makes the
// second moments of the response those of a Gaussian of the same scales, so that shape and size are
// learnt apart. As of betas, b > 1/2 keeps the mean square of the gradient over a footprint finite.
// x counts up to kMostStored, where b is 202: the response tends to exp(-sqrt(3/2) g).
// With v = -log2(e) g^2 / 2 and y = 1 - g / r: log2 f = b log2 y.
// Source: Held et al., "Triangle splatting", 2025, whose window is a power of the distance from the
// outline in the image; here it is taken in the triangle's plane, the same through every lens.

struct Triangle {
  static constexpr const char* kName = "triangle";
  static constexpr bool kHasShape = true;
  static constexpr double kExampleShapes[] = {-3.0, -1.0, 0.0, 1.5, 4.0};
  static constexpr double kRoot3 = 1.73205080756887729353;
  // The gauge is the largest of these linear forms of (x, y), pi times kArea the area where it is
  // below 1.
  static constexpr double kEdges[3][2] = {{0.0, -2.0}, {kRoot3, 1.0}, {-kRoot3, 1.0}};
  static constexpr double kArea = 0.41349667156634407;
  static constexpr double kTwoLn2 = 1.38629436111989061883;
  static constexpr double kLog2E = 1.44269504088896340736;
  static constexpr double kLeastB = 0.5;
  static constexpr double kSpan = 0.5;
  static constexpr double kMostStored = 6.0;
  // Of y and of g: less says nothing, and the derivative of g^2 / 2 to (x, y) is 0 at the centre.
  static constexpr double kLeastY = 1e-30;
  static constexpr double kLeastG = 1e-17;

  template <class T>
  static T Activate(T stored) {
    return T(kLeastB) + T(kSpan) * Exp2(T(kLog2E) * Min(stored, T(kMostStored)));
  }
  template <class T>
  static T ActivationSlope(T stored) {
    return Select(stored < T(kMostStored), Activate(stored) - T(kLeastB), T(0.0));
  }
  // The gauge, and its derivatives.
  template <class T>
  static T Gauge(T x, T y, T* by_x, T* by_y) {
    const T side = Select(x < T(0.0), T(-kRoot3), T(kRoot3));
    const T upper = side * x + y, lower = T(-2.0) * y;
    *by_x = Select(upper < lower, T(0.0), side);
    *by_y = Select(upper < lower, T(-2.0), T(1.0));
    return Max(upper, lower);
  }
  template <class T>
  static T Radius(T shape) {
    return Sqrt(T(2.0 / 3.0) * (shape + T(3.0)) * (shape + T(4.0)));
  }
  template <class T>
  static T RadiusSlope(T shape) {
    return (T(2.0) * shape + T(7.0)) / (T(3.0) * Radius(shape));
  }
  template <class T>
  static T Level(T v) {
    return Max(Sqrt(v * T(-kTwoLn2)), T(kLeastG));
  }
  template <class T>
  static T Rest(T level, T radius) {
    return Max(T(1.0) - level / radius, T(kLeastY));
  }
  template <class T>
  static T LogResponse(T v, T shape) {
    return shape * Log2(Rest(Level(v), Radius(shape)));
  }
  template <class T>
  static T Slope(T v, T shape) {
    const T g = Level(v), r = Radius(shape);
    return shape / (r * g * Rest(g, r));
  }
  template <class T>
  static T ShapeSlope(T v, T shape) {
    const T g = Level(v), r = Radius(shape), y = Rest(g, r);
    return Log2(y) + T(kLog2E) * shape * g * RadiusSlope(shape) / (r * r * y);
  }
  template <class T>
  static T Invert(T log_response, T shape) {
    const T g = Radius(shape) * (T(1.0) - Exp2(log_response / shape));
    return g * g * T(-1.0 / kTwoLn2);
  }
};
