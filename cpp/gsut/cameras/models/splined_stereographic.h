// splined_stereographic: a B-spline surface over the stereographic projection; fits any real lens.
//
//   (x, y) = 2 (X, Y) / (n + Z), n = |P|; (x', y') = (x, y) + spline(x, y);
//   u = fx x' + cx, v = fy y' + cy
//
// Parameters: order (2 or 3), Nx, Ny, fov_x in degrees, the configuration; fx fy cx cy in pixels,
// (0.5, 0.5) the centre of the top-left pixel; then the control points, dimensionless, row by row:
// Ny rows of Nx points of two numbers. Control point (i, j) stands at x = (i - (Nx - 1)/2) / s,
// y = (j - (Ny - 1)/2) / s with s = (Nx - order) / (4 tan(fov_x / 4)). mrcal's
// LENSMODEL_SPLINED_STEREOGRAPHIC is this lens. Domain: in each direction from the axis (512
// sectors) up to the first fold or the outermost control points, beyond which the surface is only
// extrapolated, at most 168 degrees; max_angle is the angle of the farthest. The derivatives to the
// configuration are 0. Inverse: Newton, safeguarded (plane_map.h). Source: mrcal's documentation of
// its splined stereographic model.

struct SplinedStereographic {
  static constexpr const char* kName = "splined_stereographic";
  static constexpr const char* kParamNames =
      "order Nx Ny fov_x_degrees fx fy cx cy control_points ...";
  static constexpr LensExample kExamples[] = {
      {"a fisheye of 140 degrees on a coarse grid, cubic",
       960,
       600,
       78,
       {3,        7,        5,        140,      230,      230.23,   481.5,    297.75,   0.26916,
        0.18181,  0.11118,  0.10465,  0.03795,  0.07045,  -0.00215, 0.05725,  -0.03287, 0.06984,
        -0.10974, 0.11204,  -0.27072, 0.17787,  0.20405,  0.07106,  0.06882,  0.03316,  0.0106,
        0.0127,   3e-05,    0.00576,  -0.00856, 0.01776,  -0.07951, 0.02677,  -0.20668, 0.06697,
        0.18624,  0.00087,  0.0634,   -0.00445, 0.00536,  0.00817,  0.00259,  0.00265,  -0.00892,
        -0.00659, -0.05426, 0.00044,  -0.19029, -0.00273, 0.20569,  -0.07244, 0.06827,  -0.03395,
        0.01387,  -0.01576, 0.00237,  -0.0033,  -0.01245, -0.01701, -0.06573, -0.03634, -0.20247,
        -0.07295, 0.27144,  -0.1786,  0.10486,  -0.11111, 0.03455,  -0.06757, -0.00393, -0.05936,
        -0.03353, -0.07053, -0.10892, -0.10682, -0.27437, -0.1775}},
      {"the same on a quadratic grid",
       960,
       600,
       68,
       {2,        6,        5,        140,      230,      230.23,   481.5,    297.75,   0.18084,
        0.13957,  0.06113,  0.08884,  0.0156,   0.06195,  -0.01597, 0.05243,  -0.06481, 0.08404,
        -0.17284, 0.14153,  0.11792,  0.045,    0.03701,  0.02503,  0.00173,  0.00858,  -0.00251,
        0.01046,  -0.02997, 0.02334,  -0.12483, 0.04874,  0.11151,  -0.009,   0.02262,  0.00013,
        -0.00484, 0.00133,  -0.00346, 0.00345,  -0.02368, 0.00268,  -0.10241, 0.00153,  0.12095,
        -0.05584, 0.04049,  -0.02276, 0.00154,  -0.00801, -0.00506, -0.00517, -0.03334, -0.02226,
        -0.12731, -0.0479,  0.17181,  -0.13809, 0.07047,  -0.09193, 0.00473,  -0.05589, -0.0044,
        -0.06237, -0.06937, -0.08347, -0.17931, -0.14278}},
  };
  static constexpr bool kHasTable = true;
  static constexpr int kChoices[] = {0, 1, 2, 3};
  static constexpr int kFocal = 4;   // where fx fy cx cy begin
  static constexpr int kPoints = 8;  // where control points begin

  static bool AcceptsParams(int num_params) { return num_params > kPoints; }

  // limits[2]: control points per unit of x; limits[3]: see families/cone.h.
  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckSplineParams(kName, params, num_params);
    return SplineDomain(params, angle_limit);
  }

  template <class T, class P>
  static auto Project(const LensDomain& domain, const P* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    const T square = x * x + y * y;
    const T n = Sqrt(square + z * z);
    const auto ahead = z > T(0.0);
    const T scale = Select(ahead, T(2.0), T(2.0) * (n - z)) / Select(ahead, n + z, square);
    const T plane_x = scale * x, plane_y = scale * y;
    const auto inside = AndMask(Cone::Contains(domain, Sqrt(square), z, n),
                                StarEdge::Contains(domain, plane_x, plane_y));
    // Outside, indices may be anything: they are kept off the table.
    const T zero(0.0);
    const T safe_x = Select(inside, plane_x, zero), safe_y = Select(inside, plane_y, zero);
    T value[2] = {zero, zero};
    if constexpr (requires { safe_x.grad; }) {
      SplineWithGradient(params, domain.limits[2], safe_x, safe_y, value);
    } else {
      Spline(params, domain.limits[2], safe_x, safe_y, value);
    }
    *u = T(params[kFocal]) * (plane_x + value[0]) + T(params[kFocal + 2]);
    *v = T(params[kFocal + 1]) * (plane_y + value[1]) + T(params[kFocal + 3]);
    return AndMask(inside, AndMask(Abs(*u) < T(kMaxPixel), Abs(*v) < T(kMaxPixel)));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    return UnprojectSpline(domain, params, u, v, ray);
  }

  static void Rescale(double* params, int /*num_params*/, double scale_x, double scale_y) {
    params[kFocal] *= scale_x;
    params[kFocal + 1] *= scale_y;
    params[kFocal + 2] *= scale_x;
    params[kFocal + 3] *= scale_y;
  }

  // The interval of a coordinate (in control points): number of the first one that counts, and the
  // weights of it and the next three (the fourth is 0 for order 2), with their derivatives.
  template <class T>
  static T Weights(bool cubic, T at, double count, T* weight, T* slope) {
    const T one(1.0), half(0.5);
    const T nearest = Floor(cubic ? at : at + half);
    const T middle = Min(Max(nearest, one), T(cubic ? count - 3.0 : count - 2.0));
    const T t = at - middle;
    if (cubic) {
      const T rest = one - t;
      const T sixth(1.0 / 6.0);
      weight[0] = sixth * rest * rest * rest;
      weight[1] = T(2.0 / 3.0) - t * t * (one - half * t);
      weight[2] = T(2.0 / 3.0) - rest * rest * (one - half * rest);
      weight[3] = sixth * t * t * t;
      slope[0] = -half * rest * rest;
      slope[1] = t * (T(1.5) * t - T(2.0));
      slope[2] = -rest * (T(1.5) * rest - T(2.0));
      slope[3] = half * t * t;
    } else {
      const T low = half - t, high = half + t;
      weight[0] = half * low * low;
      weight[1] = T(0.75) - t * t;
      weight[2] = half * high * high;
      weight[3] = T(0.0);
      slope[0] = -low;
      slope[1] = T(-2.0) * t;
      slope[2] = high;
      slope[3] = T(0.0);
    }
    return middle - one;
  }

  // The surface at (x, y); its derivatives too if dx and dy are given.
  template <class T, class P>
  static void Spline(const P* params, double density, T x, T y, T* value, T* dx = nullptr,
                     T* dy = nullptr) {
    const bool cubic = Config(params[0]) > 2.5;
    const double count_x = Config(params[1]), count_y = Config(params[2]);
    const T zero(0.0);
    T weight_x[4] = {zero, zero, zero, zero}, slope_x[4] = {zero, zero, zero, zero};
    T weight_y[4] = {zero, zero, zero, zero}, slope_y[4] = {zero, zero, zero, zero};
    const T first_x =
        Weights(cubic, x * T(density) + T(0.5 * (count_x - 1.0)), count_x, weight_x, slope_x);
    const T first_y =
        Weights(cubic, y * T(density) + T(0.5 * (count_y - 1.0)), count_y, weight_y, slope_y);
    // Rows of the block first, one sum for each of its columns and both axes.
    const int taps = cubic ? 4 : 3;
    const T first = T(2.0) * (first_y * T(count_x) + first_x) + T(1.0 * kPoints);
    const int stride = static_cast<int>(2.0 * count_x);
    T sums[kMaxColumns];
    SumRows(params, first, stride, taps, 2 * taps, weight_y, sums);
    for (int axis = 0; axis < 2; ++axis) {
      value[axis] = weight_x[0] * sums[axis];
      for (int i = 1; i < taps; ++i) value[axis] = value[axis] + weight_x[i] * sums[2 * i + axis];
    }
    if (dx == nullptr) return;
    T slopes[kMaxColumns];
    SumRows(params, first, stride, taps, 2 * taps, slope_y, slopes);
    for (int axis = 0; axis < 2; ++axis) {
      T along_x(0.0), along_y(0.0);
      for (int i = 0; i < taps; ++i) {
        along_x = along_x + slope_x[i] * sums[2 * i + axis];
        along_y = along_y + weight_x[i] * slopes[2 * i + axis];
      }
      dx[axis] = T(density) * along_x;
      dy[axis] = T(density) * along_y;
    }
  }

  // The surface with forward-mode derivatives. Those by the place are closed and those by the table
  // are sums over its block: a tenth of the work of Spline on a T with several directions.
  template <class T, class P>
  static void SplineWithGradient(const P* params, double density, const T& x, const T& y,
                                 T* value) {
    double at[2], dx[2], dy[2];
    Spline(params, density, x.value, y.value, at, dx, dy);
    for (int axis = 0; axis < 2; ++axis) {
      value[axis] = T::Chain(at[axis], x, dx[axis], y, dy[axis]);
    }
    if constexpr (requires { params->grad; }) {
      const bool cubic = Config(params[0]) > 2.5;
      const double count_x = Config(params[1]), count_y = Config(params[2]);
      double weight_x[4], weight_y[4], slope[4];
      const double first_x =
          Weights(cubic, x.value * density + 0.5 * (count_x - 1.0), count_x, weight_x, slope);
      const double first_y =
          Weights(cubic, y.value * density + 0.5 * (count_y - 1.0), count_y, weight_y, slope);
      const int taps = cubic ? 4 : 3, columns = static_cast<int>(count_x);
      const P* block =
          params + kPoints + 2 * (static_cast<int>(first_y) * columns + static_cast<int>(first_x));
      for (int k = 0; k < 2 * taps * taps; ++k) {
        const int row = k / (2 * taps), column = k / 2 % taps, axis = k % 2;
        const P& point = block[2 * (row * columns + column) + axis];
        for (std::size_t d = 0; d < point.grad.size(); ++d) {
          value[axis].grad[d] += weight_y[row] * weight_x[column] * point.grad[d];
        }
      }
    }
  }

  // The plain number of a configuration entry.
  template <class P>
  static double Config(const P& entry) {
    if constexpr (requires { entry.value; }) {
      return entry.value;
    } else {
      return static_cast<double>(entry);
    }
  }
};
