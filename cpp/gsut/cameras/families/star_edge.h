// Shared text of lenses (see contract.h): a domain of the plane whose edge depends on the
// direction.
//
// Sectors are even in the diamond angle of (x, y): y / (|x| + |y|), continued around the square. It
// rises with the azimuth and needs no arctangent.

struct StarEdge {
  static constexpr int kSectors = 512;

  // x^2 + y^2 below the edge of the sector that (x, y) lies in.
  template <class T>
  static auto Contains(const LensDomain& domain, T x, T y) {
    const T square = x * x + y * y;
    constexpr double kNotZero = 1e-30;  // keeps the centre's quotient finite, in float too
    const T size = Max(Abs(x) + Abs(y), T(kNotZero));
    const T half = y / size;
    const T two(2.0);
    const T around = Select(x < T(0.0), Select(y < T(0.0), -two - half, two - half), half);
    const T sector = Floor((around + two) * T(0.25 * kSectors));
    // NaN becomes sector 0.
    const T safe = Select(sector >= T(0.0), Min(sector, T(kSectors - 1.0)), T(0.0));
    return square < At<T>(domain.edge->data(), safe);
  }
};
