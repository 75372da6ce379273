// Essential matrices of five pairs of bearings, through the ten cubics in three unknowns.
#include "gsut/sfm/five_point.h"

#include <Eigen/LU>
#include <Eigen/QR>
#include <cmath>

#include "gsut/sfm/eigenvalues.h"

namespace gsut {
namespace {

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
  // The null space: the last four columns of Q of a QR decomposition. An SVD would cost several
  // times as much for the same space, and only the space matters.
  const Eigen::HouseholderQR<Eigen::Matrix<double, 9, 5>> qr(equations);
  const Eigen::Matrix<double, 9, 9> orthogonal = qr.householderQ();
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

}  // namespace gsut
