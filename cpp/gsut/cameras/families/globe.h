// Shared text of lenses (see contract.h): longitude and latitude of a direction, for panoramas.
//
// With (across, up, ahead) the coordinates permuted so that the poles lie along `up`:
//   longitude = atan2(across, ahead) in [-pi, pi], latitude = atan2(up, hypot(across, ahead)).
// The two poles have no longitude and are the only directions outside the domain (unless it is cut
// to a cone). Straight behind lies on the seam, longitude +pi or, for across = -0.0, -pi.

struct Globe {
  template <class T>
  static auto Angles(const LensDomain& domain, T across, T up, T ahead, T x, T y, T z, T* longitude,
                     T* latitude) {
    const T level_square = across * across + ahead * ahead;
    const T level = Sqrt(level_square);
    *longitude = Atan2(across, ahead);
    *latitude = Atan2(up, level);
    const auto inside =
        Cone::ContainsOrBehind(domain, Sqrt(x * x + y * y), z, Sqrt(level_square + up * up));
    return AndMask(inside, level > T(0.0));
  }

  // up: the axis of the camera frame that the poles lie along.
  static LensDomain MakeDomain(double angle_limit, int up, double period_u, double period_v) {
    LensDomain domain;
    SetCone(angle_limit < kPi ? angle_limit : kPi, &domain);
    domain.pole_axis = up;
    domain.period_u = period_u;
    domain.period_v = period_v;
    return domain;
  }

  // False beyond the seam and the poles, which other pixels stand for.
  static bool Direction(double longitude, double latitude, double* across, double* up,
                        double* ahead) {
    if (!(std::abs(longitude) <= kPi && std::abs(latitude) < 0.5 * kPi)) return false;
    *across = std::sin(longitude) * std::cos(latitude);
    *up = std::sin(latitude);
    *ahead = std::cos(longitude) * std::cos(latitude);
    return true;
  }
};
