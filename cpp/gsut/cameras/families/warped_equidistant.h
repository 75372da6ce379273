// Shared text of lenses (see contract.h): an equidistant fisheye whose plane is distorted.

// Parameters: fx fy cx cy, then those of Lens::Distort(coefficients, x, y, u, v), which maps the
// plane of equidistant_plane.h to itself.
template <class Lens>
struct WarpedEquidistant {
  static PlaneMap Map(const double* params) {
    return MakePlaneMap([params](const auto& x, const auto& y, auto* u, auto* v) {
      Lens::Distort(params + 4, x, y, u, v);
    });
  }

  static LensDomain MakeDomain(const double* params, int num_params, double angle_limit = kPi) {
    CheckFocalParams(Lens::kName, Lens::kParamNames, params, num_params);
    return PlaneChartDomain(PlaneChart::kEquidistant, params, Map(params), angle_limit);
  }

  template <class T>
  static auto Project(const LensDomain& domain, const T* params, int /*num_params*/, T x, T y, T z,
                      T* u, T* v) {
    T plane_x(0.0), plane_y(0.0), distorted_x(0.0), distorted_y(0.0);
    const auto inside = EquidistantPlane::FromPoint(domain, x, y, z, &plane_x, &plane_y);
    Lens::Distort(params + 4, plane_x, plane_y, &distorted_x, &distorted_y);
    return AndMask(inside, ImagePlane::ToPixel(params, distorted_x, distorted_y, u, v));
  }

  static bool Unproject(const LensDomain& domain, const double* params, int /*num_params*/,
                        double u, double v, double* ray) {
    return UnprojectPlaneChart(PlaneChart::kEquidistant, domain, params, Map(params), u, v, ray);
  }
};
