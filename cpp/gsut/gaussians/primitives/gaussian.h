// gaussian: exp(-D^2 / 2), D the smallest Mahalanobis distance along the ray.
//
// Surfels are Gaussians that are thin along one axis, see gaussians/surfels.h.
// Source: Kerbl et al., "3D Gaussian splatting for real-time radiance field rendering", 2023.

struct Gaussian {
  static constexpr const char* kName = "gaussian";
  static constexpr bool kHasShape = false;
  static constexpr double kExampleShapes[] = {0.0};

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
    return v;
  }
  template <class T>
  static T Slope(T /*v*/, T /*shape*/) {
    return T(1.0);
  }
  template <class T>
  static T ShapeSlope(T /*v*/, T /*shape*/) {
    return T(0.0);
  }
  template <class T>
  static T Invert(T log_response, T /*shape*/) {
    return log_response;
  }
};
