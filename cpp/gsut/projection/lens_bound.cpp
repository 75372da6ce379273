// Runs a lens on boxes of directions, and turns derivatives along a face of a cube into those in
// space.
#include "gsut/projection/lens_bound.h"

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "gsut/cameras/lens_registry.h"
#include "gsut/projection/enclosed.h"

namespace gsut {
namespace {

using Pixels = std::array<TaylorBox, 2>;
constexpr float kUnbounded = std::numeric_limits<float>::infinity();
constexpr Bend kUnknown = {kUnbounded, kUnbounded, kUnbounded};

// The point of a face with its two coordinates as variables.
std::array<Enclosed, 3> VariablePoint(int face, Interval x, Interval y) {
  TaylorBox along_x(x), along_y(y);
  along_x.c[1] = along_y.c[2] = 1.0;
  const Enclosed side(face % 2 == 0 ? 1.0 : -1.0), a(along_x), b(along_y);
  if (face < 2) return {side, a, b};
  if (face < 4) return {a, side, b};
  return {a, b, side};
}

// Pixels over a box; false if it is not certainly inside the domain.
template <class Lens>
bool RunLens(const Camera& camera, int face, Interval x, Interval y, Pixels* pixels) {
  const std::array<Enclosed, 3> p = VariablePoint(face, x, y);
  Enclosed u, v;
  Verdict inside;
  if constexpr (requires { Lens::kHasTable; }) {
    inside = Lens::Project(camera.domain(), camera.params().data(), camera.num_params(), p[0], p[1],
                           p[2], &u, &v);
  } else {
    std::vector<Enclosed> params;
    for (const double value : camera.params()) params.push_back(Enclosed(value));
    inside = Lens::Project(camera.domain(), params.data(), camera.num_params(), p[0], p[1], p[2],
                           &u, &v);
  }
  *pixels = {u.Plain(), v.Plain()};
  return inside.Holds();
}

// Narrows derivatives by the ones at the middle of the box and the next order over all of it.
void Tighten(const TaylorBox& middle, double radius_x, double radius_y, TaylorBox* t) {
  const Interval x(-radius_x, radius_x), y(-radius_y, radius_y);
  auto& c = t->c;
  const auto& m = middle.c;
  if (!std::all_of(c.begin() + 1, c.end(), [](Interval i) { return i.IsFinite(); })) return;
  c[3] = Intersection(c[3], m[3] + 3.0 * c[6] * x + c[7] * y);
  c[4] = Intersection(c[4], m[4] + 2.0 * c[7] * x + 2.0 * c[8] * y);
  c[5] = Intersection(c[5], m[5] + c[8] * x + 3.0 * c[9] * y);
  c[1] = Intersection(c[1], m[1] + 2.0 * c[3] * x + c[4] * y);
  c[2] = Intersection(c[2], m[2] + c[4] * x + 2.0 * c[5] * y);
}

template <class Lens>
bool EnclosePixels(const Camera& camera, int face, Interval x, Interval y, Pixels* pixels) {
  FloorPieces& pieces = FloorPieces::Current();
  for (pieces.choice = 0;; ++pieces.choice) {
    pieces.pieces = 1;
    Pixels piece;
    if (!RunLens<Lens>(camera, face, x, y, &piece)) return false;
    for (std::size_t axis = 0; axis < 2; ++axis) {
      (*pixels)[axis] = pieces.choice == 0 ? piece[axis] : Hull((*pixels)[axis], piece[axis]);
    }
    if (pieces.choice + 1 >= pieces.pieces) break;
  }
  if (pieces.pieces > 1) return true;
  Pixels middle;
  pieces.choice = 0;
  if (!RunLens<Lens>(camera, face, x.Middle(), y.Middle(), &middle)) return false;
  for (std::size_t axis = 0; axis < 2; ++axis) {
    Tighten(middle[axis], x.Radius(), y.Radius(), &(*pixels)[axis]);
  }
  return true;
}

double LargestEigenvalue(const Interval h[3][3]) {
  Eigen::Matrix3d middle, radius;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      middle(i, j) = h[i][j].Middle();
      radius(i, j) = h[i][j].Radius();
    }
  }
  if (!middle.allFinite() || !radius.allFinite()) return kUnbounded;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(middle, Eigen::EigenvaluesOnly);
  return solver.eigenvalues().cwiseAbs().maxCoeff() + radius.norm();
}

struct Norms {
  double first, second, third;
};

// Norms in space of the derivatives D, B, C along the face's coordinates c at p = (c, 1): since f
// is the same along rays, Df[p] = 0, D^2 f[p, t] = -Df[t], D^3 f[p, s, t] = -2 D^2 f[s, t]; with n
// the face's normal, n = p - c.
Norms NormsInSpace(const TaylorBox& t, const Interval p[2]) {
  const auto& c = t.c;
  const Interval d[2] = {c[1], c[2]};
  const Interval b[2][2] = {{2.0 * c[3], c[4]}, {c[4], 2.0 * c[5]}};
  const Interval cubic[4] = {6.0 * c[6], 2.0 * c[7], 2.0 * c[8], 6.0 * c[9]};
  const auto third = [&cubic](int i, int j, int k) { return cubic[i + j + k]; };
  Interval bp[2], pbp, dp, c_p[2][2], c_pp[2], c_ppp;
  for (int i = 0; i < 2; ++i) {
    dp = dp + d[i] * p[i];
    for (int j = 0; j < 2; ++j) {
      bp[i] = bp[i] + b[i][j] * p[j];
      for (int k = 0; k < 2; ++k) c_p[i][j] = c_p[i][j] + third(i, j, k) * p[k];
    }
    for (int j = 0; j < 2; ++j) c_pp[i] = c_pp[i] + c_p[i][j] * p[j];
    pbp = pbp + bp[i] * p[i];
    c_ppp = c_ppp + c_pp[i] * p[i];
  }
  Interval h[3][3];
  double third_square = 0.0;
  const auto add = [&third_square](double times, Interval entry) {
    third_square += times * entry.Magnitude() * entry.Magnitude();
  };
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 2; ++j) {
      h[i][j] = b[i][j];
      for (int k = 0; k < 2; ++k) add(1.0, third(i, j, k));
      add(3.0, -2.0 * b[i][j] - c_p[i][j]);
    }
    h[i][2] = h[2][i] = -d[i] - bp[i];
    add(3.0, 2.0 * d[i] + 4.0 * bp[i] + c_pp[i]);
  }
  h[2][2] = 2.0 * dp + pbp;
  add(1.0, 6.0 * dp + 6.0 * pbp + c_ppp);
  const double first = std::sqrt(Square(d[0]).high + Square(d[1]).high + Square(dp).high);
  return {first, LargestEigenvalue(h), std::sqrt(third_square)};
}

template <class Lens>
Bend BoundOf(const Camera& camera, int face, Interval x, Interval y) {
  Pixels pixels;
  if (!EnclosePixels<Lens>(camera, face, x, y, &pixels)) return kUnknown;
  const Interval place[2] = {x, y};
  const double farthest = 1.0 + Square(x).high + Square(y).high, norm = std::sqrt(farthest);
  Norms worst = {0.0, 0.0, 0.0};
  for (const TaylorBox& pixel : pixels) {
    const Norms norms = NormsInSpace(pixel, place);
    worst.first = std::max(worst.first, norm * norms.first);
    worst.second = std::max(worst.second, farthest * norms.second);
    worst.third = std::max(worst.third, farthest * norm * norms.third);
  }
  // A quadratic spline's second derivative jumps.
  if constexpr (requires { Lens::Config(1.0); }) {
    constexpr double kCubic = 3.0;
    if (Lens::Config(camera.params()[0]) < kCubic) worst.third = kUnbounded;
  }
  const auto as_float = [](double value) {
    const double wider = (1.0 + kIntervalRounding) * value;
    return wider < std::numeric_limits<float>::max() ? static_cast<float>(wider) : kUnbounded;
  };
  return {as_float(worst.first), as_float(worst.second), as_float(worst.third)};
}

}  // namespace

void FacePoint(int face, double x, double y, double point[3]) {
  const int axis = face / 2;
  point[axis] = face % 2 == 0 ? 1.0 : -1.0;
  point[axis == 0 ? 1 : 0] = x;
  point[axis == 2 ? 1 : 2] = y;
}

Bend BoundBend(const Camera& camera, int face, Interval x, Interval y) {
  return VisitLens(camera.lens(), [&](auto lens) -> Bend {
    using Lens = decltype(lens);
    if constexpr (requires { Lens::kIsParallel; }) {
      const std::array<Enclosed, 3> p = VariablePoint(face, x, y);
      return (p[2] > Enclosed(0.0)).Holds() ? Bend{kUnbounded, 0.0f, 0.0f} : kUnknown;
    } else if constexpr (requires { Lens::kHasOrigins; }) {
      return kUnknown;
    } else {
      return BoundOf<Lens>(camera, face, x, y);
    }
  });
}

}  // namespace gsut
