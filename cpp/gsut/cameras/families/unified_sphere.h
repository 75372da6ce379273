// Shared text of lenses (see contract.h): the extended unified model, of which the unified model is
// the case beta = 1.
//
//   d = sqrt(beta (X^2 + Y^2) + Z^2), u = fx X / (alpha d + (1 - alpha) Z) + cx, v likewise.
//
// With w = alpha / (1 - alpha) for alpha <= 1/2 (a pole: pixels go to infinity) and
// (1 - alpha) / alpha beyond (a fold: the radius stops rising), the domain is Z > -w d, the cone of
// angle pi - atan2(sqrt(1 - w^2), w sqrt(beta)).

struct UnifiedSphere {
  static LensDomain MakeDomain(const double* params, double alpha, double beta,
                               double angle_limit) {
    const double w = alpha <= 0.5 ? alpha / (1.0 - alpha) : (1.0 - alpha) / alpha;
    const double edge = kPi - std::atan2(std::sqrt((1.0 - w) * (1.0 + w)), w * std::sqrt(beta));
    return RadialDomain(params, edge, angle_limit, [alpha, beta](double angle) {
      const double sine = std::sin(angle), cosine = std::cos(angle);
      const double d = std::sqrt(beta * sine * sine + cosine * cosine);
      return sine / (alpha * d + (1.0 - alpha) * cosine);
    });
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, T alpha, T beta, T x, T y, T z,
                      T* u, T* v) {
    const T square = x * x + y * y;
    const T square_z = z * z;
    const auto inside = Cone::Contains(domain, Sqrt(square), z, Sqrt(square + square_z));
    const T bent = beta * square;
    const T scale = Scale(alpha, Sqrt(bent + square_z), bent, z);
    return AndMask(inside, ImagePlane::ToPixel(params, scale * x, scale * y, u, v));
  }

  // 1 / (alpha d + (1 - alpha) z) with d = sqrt(bent + z^2). Behind, where the sum cancels, it is
  // (alpha d - (1 - alpha) z) / (alpha^2 bent - (1 - 2 alpha) z^2).
  template <class T>
  static T Scale(T alpha, T d, T bent, T z) {
    const T one(1.0);
    const T first = alpha * d, second = (one - alpha) * z;
    const T below = alpha * alpha * bent + (alpha + alpha - one) * (z * z);
    const auto in_front = z > T(0.0);
    return Select(in_front, one, first - second) / Select(in_front, first + second, below);
  }

  // The ray through (x, y) is (x, y, Depth).
  static double Depth(double alpha, double beta, double square) {
    const double root = std::sqrt(std::max(0.0, 1.0 - (2.0 * alpha - 1.0) * beta * square));
    return (1.0 - beta * alpha * alpha * square) / (alpha * root + 1.0 - alpha);
  }

  static bool Unproject(const LensDomain& domain, const double* params, double alpha, double beta,
                        double u, double v, double* ray) {
    double x = 0.0, y = 0.0;
    if (!FromPixel(params, u, v, &x, &y)) return false;
    const double square = x * x + y * y;
    if (!(square < domain.max_radius * domain.max_radius)) return false;
    return RayInCone(domain, x, y, Depth(alpha, beta, square), ray);
  }
};
