// Calls of Eigen that take it seconds to compile.
#include "gsut/sfm/dense.h"

#include <Eigen/Cholesky>

namespace gsut {

bool FactorizeCholesky(Eigen::Ref<Eigen::MatrixXd> matrix) {
  return Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>>(matrix).info() == Eigen::Success;
}

void SolveCholesky(const Eigen::Ref<const Eigen::MatrixXd>& lower, Eigen::Ref<Eigen::VectorXd> x) {
  lower.triangularView<Eigen::Lower>().solveInPlace(x);
  lower.transpose().triangularView<Eigen::Upper>().solveInPlace(x);
}

void SolveLower(const Eigen::Ref<const Eigen::MatrixXd>& lower, Eigen::Ref<Eigen::MatrixXd> x) {
  lower.triangularView<Eigen::Lower>().solveInPlace(x);
}

Eigen::MatrixXd MultiplyByTranspose(const Eigen::Ref<const Eigen::MatrixXd>& x) {
  return x.transpose() * x;
}

}  // namespace gsut
