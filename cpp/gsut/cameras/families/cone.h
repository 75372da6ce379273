// Shared text of lenses (see contract.h): inside the cone of the domain, right at every angle.
//
// The angle from the axis is compared by the tangent of its half, h / (n + z) with h = |(x, y)| and
// n = |(x, y, z)|, which is as exact in front of the camera as behind it, and needs no arctangent.
// limits[3] of the domain is the same of max_angle: see SetCone.

struct Cone {
  // angle < max_angle. False for the zero vector and where squares overflow. A cone of pi leaves
  // out the one direction straight behind.
  template <class T>
  static auto Contains(const LensDomain& domain, T h, T z, T n) {
    return HalfTangent(h, z, n) < T(domain.limits[3]);
  }

  // The same, but a cone of pi leaves out nothing: for lenses that see every direction.
  template <class T>
  static auto ContainsOrBehind(const LensDomain& domain, T h, T z, T n) {
    constexpr double kLargest = 1e30;
    const auto inside = Min(HalfTangent(h, z, n), T(kLargest)) < T(domain.limits[3]);
    return AndMask(inside, AndMask(n > T(0.0), n < T(kInfinity)));
  }

  template <class T>
  static T HalfTangent(T h, T z, T n) {
    const auto ahead = z > T(0.0);
    return Select(ahead, h, n - z) / Select(ahead, n + z, h);
  }
};
