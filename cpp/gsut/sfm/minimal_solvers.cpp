// Minimal solvers: five pairs of bearings by their ten cubics, three bearings by Grunert's quartic.
#include "gsut/sfm/minimal_solvers.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/Householder>
#include <cmath>
#include <complex>

namespace gsut {
namespace {

// At most 10 x 10, without an allocation; one type, as the solver takes seconds to compile for
// each.
using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, 10, 10>;
using SmallComplexMatrix =
    Eigen::Matrix<std::complex<double>, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, 10, 10>;
using SmallComplexVector =
    Eigen::Matrix<std::complex<double>, Eigen::Dynamic, 1, Eigen::ColMajor, 10, 1>;

// The eigenvalues of a square matrix and, where vectors is not null, the eigenvectors in its
// columns. False if the iteration did not converge.
bool FindEigenvalues(const SmallMatrix& matrix, SmallComplexVector* values,
                     SmallComplexMatrix* vectors = nullptr) {
  const Eigen::EigenSolver<SmallMatrix> solver(matrix, vectors != nullptr);
  if (solver.info() != Eigen::Success) return false;
  *values = solver.eigenvalues();
  if (vectors != nullptr) *vectors = solver.eigenvectors();
  return true;
}

// --- five pairs of bearings ---

// A pair of rays gives one linear equation b2^T E b1 = 0 in the nine entries of E. Five pairs leave
// a null space of four matrices A, B, C, D, and every solution is
//   E = x A + y B + z C + D
// up to its length. Two properties of essential matrices, det E = 0 and 2 E E^T E = tr(E E^T) E,
// are 1 + 9 = 10 cubic equations in x, y, z. Ordered as below, the ten cubic monomials come first:
// solving for them expresses each by the ten lower ones (a Groebner basis in graded order, which
// for this problem needs no more elimination than one 10 x 10 inverse). Multiplication by x then
// maps the span of the lower monomials to itself, and its eigenvalues are the x of the ten
// solutions, its eigenvectors their lower monomials.
//
// E = x A + y B + z C + D. Polynomials in (x, y, z) are vectors of coefficients in this order:
//   degree 1:  x y z 1
//   degree 2:  xx xy xz yy yz zz x y z 1
//   degree 3:  xxx xxy xxz xyy xyz xzz yyy yyz yzz zzz, then as degree 2
constexpr int kLinear = 4;
constexpr int kQuadratic = 10;
constexpr int kCubic = 20;

using Linear = Eigen::Matrix<double, kLinear, 1>;
using Quadratic = Eigen::Matrix<double, kQuadratic, 1>;
using Cubic = Eigen::Matrix<double, kCubic, 1>;

// Where the product of two monomials stands.
constexpr int kProduct11[kLinear][kLinear] = {
    {0, 1, 2, 6}, {1, 3, 4, 7}, {2, 4, 5, 8}, {6, 7, 8, 9}};
constexpr int kProduct21[kQuadratic][kLinear] = {
    {0, 1, 2, 10}, {1, 3, 4, 11},    {2, 4, 5, 12},    {3, 6, 7, 13},    {4, 7, 8, 14},
    {5, 8, 9, 15}, {10, 11, 12, 16}, {11, 13, 14, 17}, {12, 14, 15, 18}, {16, 17, 18, 19}};

// The product of two polynomials of degree 1.
Quadratic Multiply(const Linear& a, const Linear& b) {
  Quadratic product = Quadratic::Zero();
  for (int i = 0; i < kLinear; ++i) {
    for (int j = 0; j < kLinear; ++j) product[kProduct11[i][j]] += a[i] * b[j];
  }
  return product;
}

// The product of polynomials of degree 2 and 1.
Cubic Multiply(const Quadratic& a, const Linear& b) {
  Cubic product = Cubic::Zero();
  for (int i = 0; i < kQuadratic; ++i) {
    for (int j = 0; j < kLinear; ++j) product[kProduct21[i][j]] += a[i] * b[j];
  }
  return product;
}

using LinearMatrix = std::array<std::array<Linear, 3>, 3>;

// The ten cubics that the coefficients of a combination of null vectors must fulfil.
Eigen::Matrix<double, 10, kCubic> Constraints(const LinearMatrix& e) {
  // G = E E^T (symmetric), then (G - tr(G) / 2 I) E = 0 and det E = 0.
  std::array<std::array<Quadratic, 3>, 3> gram;
  for (int i = 0; i < 3; ++i) {
    for (int j = i; j < 3; ++j) {
      gram[i][j] =
          Multiply(e[i][0], e[j][0]) + Multiply(e[i][1], e[j][1]) + Multiply(e[i][2], e[j][2]);
      gram[j][i] = gram[i][j];
    }
  }
  const Quadratic half_trace = 0.5 * (gram[0][0] + gram[1][1] + gram[2][2]);
  for (int i = 0; i < 3; ++i) gram[i][i] -= half_trace;
  Eigen::Matrix<double, 10, kCubic> rows;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      rows.row(3 * i + j) = Multiply(gram[i][0], e[0][j]) + Multiply(gram[i][1], e[1][j]) +
                            Multiply(gram[i][2], e[2][j]);
    }
  }
  // det E by its first row: three minors of the others.
  const auto minor = [&](int a, int b) -> Quadratic {
    return Multiply(e[1][a], e[2][b]) - Multiply(e[1][b], e[2][a]);
  };
  rows.row(9) = Multiply(minor(1, 2), e[0][0]) + Multiply(minor(2, 0), e[0][1]) +
                Multiply(minor(0, 1), e[0][2]);
  return rows;
}

}  // namespace

std::vector<Eigen::Matrix3d> FivePoint(const std::array<Eigen::Vector3d, 5>& rays1,
                                       const std::array<Eigen::Vector3d, 5>& rays2) {
  // One row a pair: the entries of E, row by row, times ray2 ray1^T.
  Eigen::Matrix<double, 9, 5> equations;
  for (int i = 0; i < 5; ++i) {
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) equations(3 * r + c, i) = rays2[i][r] * rays1[i][c];
    }
  }
  // The null space: the last four columns of Q of a QR decomposition by Householder reflections. An
  // SVD would cost several times as much for the same space, and only the space matters. Eigen's
  // own QR does the same steps; its blocked variant, which so few columns never reach, takes longer
  // to compile than the rest of this file.
  constexpr int kRows = 9;     // entries of E
  constexpr int kColumns = 5;  // pairs of bearings
  Eigen::Matrix<double, kColumns, 1> coefficients;
  Eigen::Matrix<double, kRows, 1> workspace;
  for (int k = 0; k < kColumns; ++k) {
    double beta = 0.0;
    equations.col(k).tail(kRows - k).makeHouseholderInPlace(coefficients[k], beta);
    equations(k, k) = beta;
    equations.bottomRightCorner(kRows - k, kColumns - 1 - k)
        .applyHouseholderOnTheLeft(equations.col(k).tail(kRows - 1 - k), coefficients[k],
                                   workspace.data());
  }
  Eigen::Matrix<double, kRows, kRows> orthogonal = Eigen::Matrix<double, kRows, kRows>::Identity();
  for (int k = kColumns - 1; k >= 0; --k) {
    orthogonal.bottomRightCorner(kRows - k, kRows - k)
        .applyHouseholderOnTheLeft(equations.col(k).tail(kRows - 1 - k), coefficients[k],
                                   workspace.data());
  }
  const Eigen::Matrix<double, 9, 4> null_space = orthogonal.rightCols<4>();
  LinearMatrix e;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) e[r][c] = null_space.row(3 * r + c).transpose();
  }
  const Eigen::Matrix<double, 10, kCubic> rows = Constraints(e);
  // Cubic monomials in terms of the others: cubic = -reduced * (quadratic, linear, 1).
  const Eigen::Matrix<double, 10, 10> reduced =
      rows.leftCols<10>().partialPivLu().solve(rows.rightCols<10>());
  if (!reduced.allFinite()) return {};
  // Multiplication by x of the basis xx xy xz yy yz zz x y z 1.
  SmallMatrix action = SmallMatrix::Zero(10, 10);
  for (int i = 0; i < 6; ++i) action.row(i) = -reduced.row(i);  // xxx xxy xxz xyy xyz xzz
  action(6, 0) = 1.0;
  action(7, 1) = 1.0;
  action(8, 2) = 1.0;
  action(9, 6) = 1.0;
  SmallComplexVector values;
  SmallComplexMatrix vectors;
  if (!FindEigenvalues(action, &values, &vectors)) return {};
  std::vector<Eigen::Matrix3d> solutions;
  for (int i = 0; i < 10; ++i) {
    // Complex solutions come in pairs, and are no cameras.
    if (values[i].imag() != 0.0) continue;
    const Eigen::Matrix<double, 10, 1> v = vectors.col(i).real();
    // (x, y, z, 1) up to a factor stands in the last four rows.
    Eigen::Vector4d weights = v.tail<4>();
    const Eigen::Matrix<double, 9, 1> entries = null_space * weights;
    const double norm = entries.norm();
    if (!(norm > 0.0) || !std::isfinite(norm)) continue;
    Eigen::Matrix3d solution;
    solution << entries[0], entries[1], entries[2], entries[3], entries[4], entries[5], entries[6],
        entries[7], entries[8];
    solutions.push_back(solution * (std::sqrt(2.0) / norm));
  }
  return solutions;
}

// --- three bearings and their points ---

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
