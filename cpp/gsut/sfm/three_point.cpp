// Camera poses of three bearings: Grunert's quartic, Newton on the depths, two triads.
#include "gsut/sfm/three_point.h"

#include <Eigen/LU>
#include <cmath>

#include "gsut/sfm/eigenvalues.h"

namespace gsut {
namespace {

// Three rays with angles a, b, g between them see a triangle with known sides A, B, C. The
// distances s1, s2, s3 along the rays follow from three laws of cosines,
//   s2^2 + s3^2 - 2 s2 s3 cos a = A^2,
//   s1^2 + s3^2 - 2 s1 s3 cos b = B^2,
//   s1^2 + s2^2 - 2 s1 s2 cos g = C^2.
// With s2 = u s1 and s3 = v s1, the quotients of pairs of them lose s1; one then gives u as a
// rational function of v, and the other becomes a quartic in v with up to four real roots.

// Newton's steps on the three laws: the quartic loses half of the digits near double roots.
constexpr int kNewtonSteps = 5;

// Real roots of c[0] + c[1] x + ... + c[4] x^4: eigenvalues of the companion matrix. Roots with a
// small imaginary part are kept, since rounding splits double roots; Newton decides later.
std::vector<double> QuarticRoots(const std::array<double, 5>& c) {
  constexpr double kImaginary = 1e-4;
  if (!(std::abs(c[4]) > 0.0)) return {};
  SmallMatrix companion = SmallMatrix::Zero(4, 4);
  for (int i = 0; i < 4; ++i) companion(i, 3) = -c[i] / c[4];
  for (int i = 0; i < 3; ++i) companion(i + 1, i) = 1.0;
  if (!companion.allFinite()) return {};
  SmallComplexVector values;
  if (!FindEigenvalues(companion, &values)) return {};
  std::vector<double> roots;
  for (int i = 0; i < 4; ++i) {
    const std::complex<double> root = values[i];
    if (std::abs(root.imag()) <= kImaginary * (1.0 + std::abs(root.real()))) {
      roots.push_back(root.real());
    }
  }
  return roots;
}

// Columns: an orthonormal frame of the triangle.
bool Triad(const std::array<Eigen::Vector3d, 3>& p, Eigen::Matrix3d* frame) {
  constexpr double kCollinear = 1e-12;  // sine of the angle at a corner; below, rounding decides
  const Eigen::Vector3d x = p[1] - p[0];
  const Eigen::Vector3d z = x.cross(p[2] - p[0]);
  if (!(x.norm() > 0.0) || !(z.norm() > kCollinear * x.norm() * (p[2] - p[0]).norm())) return false;
  frame->col(0) = x.normalized();
  frame->col(2) = z.normalized();
  frame->col(1) = frame->col(2).cross(frame->col(0));
  return true;
}

}  // namespace

std::vector<Pose> ThreePoint(const std::array<Eigen::Vector3d, 3>& rays,
                             const std::array<Eigen::Vector3d, 3>& points) {
  Eigen::Matrix3d world_triad;
  if (!Triad(points, &world_triad)) return {};
  // Sides opposite to the points 1, 2, 3, squared, and cosines between the other two rays.
  const double a2 = (points[1] - points[2]).squaredNorm();
  const double b2 = (points[0] - points[2]).squaredNorm();
  const double c2 = (points[0] - points[1]).squaredNorm();
  const double cos_a = rays[1].dot(rays[2]);
  const double cos_b = rays[0].dot(rays[2]);
  const double cos_g = rays[0].dot(rays[1]);
  // With s2 = u s1 and s3 = v s1: a quartic in v (Haralick et al., equation 9).
  const double m = (a2 - c2) / b2;
  const double n = (a2 + c2) / b2;
  const double q = (b2 - c2) / b2;
  const double o = (b2 - a2) / b2;
  const double a_over_b = a2 / b2;
  const double c_over_b = c2 / b2;
  const std::array<double, 5> quartic = {
      (1 + m) * (1 + m) - 4 * a_over_b * cos_g * cos_g,
      4 * (-m * (1 + m) * cos_b + 2 * a_over_b * cos_g * cos_g * cos_b - (1 - n) * cos_a * cos_g),
      2 * (m * m - 1 + 2 * m * m * cos_b * cos_b + 2 * q * cos_a * cos_a -
           4 * n * cos_a * cos_b * cos_g + 2 * o * cos_g * cos_g),
      4 * (m * (1 - m) * cos_b - (1 - n) * cos_a * cos_g + 2 * c_over_b * cos_a * cos_a * cos_b),
      (m - 1) * (m - 1) - 4 * c_over_b * cos_a * cos_a};
  std::vector<Pose> poses;
  for (const double v : QuarticRoots(quartic)) {
    const double denominator = 2.0 * (cos_g - v * cos_a);
    const double u = ((-1 + m) * v * v - 2 * m * cos_b * v + 1 + m) / denominator;
    const double s1_squared = b2 / (1.0 + v * v - 2.0 * v * cos_b);
    if (!std::isfinite(u) || !(s1_squared > 0.0)) continue;
    Eigen::Vector3d s(1.0, u, v);
    s *= std::sqrt(s1_squared);
    // Newton on the three laws of cosines themselves, whose derivatives are simple.
    Eigen::Vector3d error;
    for (int step = 0; step < kNewtonSteps; ++step) {
      error << s[1] * s[1] + s[2] * s[2] - 2 * s[1] * s[2] * cos_a - a2,
          s[0] * s[0] + s[2] * s[2] - 2 * s[0] * s[2] * cos_b - b2,
          s[0] * s[0] + s[1] * s[1] - 2 * s[0] * s[1] * cos_g - c2;
      Eigen::Matrix3d jacobian;
      jacobian << 0, 2 * (s[1] - s[2] * cos_a), 2 * (s[2] - s[1] * cos_a),
          2 * (s[0] - s[2] * cos_b), 0, 2 * (s[2] - s[0] * cos_b), 2 * (s[0] - s[1] * cos_g),
          2 * (s[1] - s[0] * cos_g), 0;
      const Eigen::Vector3d change = jacobian.partialPivLu().solve(error);
      if (!change.allFinite()) break;
      s -= change;
    }
    constexpr double kSideTolerance = 1e-6;  // relative; spurious roots are far above
    const bool solved = error.cwiseAbs().maxCoeff() < kSideTolerance * (a2 + b2 + c2);
    if (!solved || !(s.minCoeff() > 0.0)) continue;
    // The triangle is now known in the camera's frame too: the rotation carries one triad to the
    // other, and the first corner gives the translation.
    Eigen::Matrix3d camera_triad;
    const std::array<Eigen::Vector3d, 3> seen = {s[0] * rays[0], s[1] * rays[1], s[2] * rays[2]};
    if (!Triad(seen, &camera_triad)) continue;
    Pose pose;
    pose.rotation = camera_triad * world_triad.transpose();
    pose.translation = seen[0] - pose.rotation * points[0];
    poses.push_back(pose);
  }
  return poses;
}

}  // namespace gsut
