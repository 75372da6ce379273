// Shared text of lenses (see contract.h): the last step of most lenses, focal lengths and centre.

struct ImagePlane {
  // u = fx x + cx, v = fy y + cy. Mask: both coordinates within kMaxPixel (false for NaN).
  template <class T>
  static auto ToPixel(const T* params, T x, T y, T* u, T* v) {
    *u = params[0] * x + params[2];
    *v = params[1] * y + params[3];
    return AndMask(Abs(*u) < T(kMaxPixel), Abs(*v) < T(kMaxPixel));
  }
};
