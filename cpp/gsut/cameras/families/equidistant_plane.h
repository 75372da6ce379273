// Shared text of lenses (see contract.h): the plane in which the distance from the centre is the
// angle from the axis.

struct EquidistantPlane {
  // (x, y) = theta (X, Y) / h with h = |(X, Y)|, theta = atan2(h, Z). Mask: theta below max_angle.
  template <class T>
  static auto FromPoint(const LensDomain& domain, T x, T y, T z, T* plane_x, T* plane_y) {
    const T square = x * x + y * y;
    const T square_z = z * z;
    const T h = Sqrt(square);
    // theta/h = (1 - q/3)/z with q = (h/z)^2, to less than half a unit in the last place while
    // the next term, q^2/5, is below a double's.
    constexpr double kNearAxis = 1e-12;  // of q
    const auto near_axis = AndMask(z > T(0.0), square < T(kNearAxis) * square_z);
    const T angle = Atan2(h, z);
    const T series = (T(1.0) - square / square_z * T(1.0 / 3.0)) / z;
    const T scale = Select(near_axis, series, angle / h);
    *plane_x = scale * x;
    *plane_y = scale * y;
    return AndMask(OrMask(near_axis, angle < T(domain.max_angle)), square < T(kInfinity));
  }
};
