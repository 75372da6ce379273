// Eigen's products and factorisations of large matrices, each compiled once: a file that calls
// Eigen's own takes seconds longer to compile for each.
#pragma once

#include <Eigen/Core>

namespace gsut {

// Factorises a symmetric matrix, of which the lower triangle is read, in its own memory: the lower
// triangle becomes L of L L^T. False if it is not positive definite.
bool FactorizeCholesky(Eigen::Ref<Eigen::MatrixXd> matrix);

// Replaces x by (L L^T)^-1 x, of the lower triangle L.
void SolveCholesky(const Eigen::Ref<const Eigen::MatrixXd>& lower, Eigen::Ref<Eigen::VectorXd> x);

// Replaces x by L^-1 x, of the lower triangle L.
void SolveLower(const Eigen::Ref<const Eigen::MatrixXd>& lower, Eigen::Ref<Eigen::MatrixXd> x);

// Returns x^T x.
Eigen::MatrixXd MultiplyByTranspose(const Eigen::Ref<const Eigen::MatrixXd>& x);

}  // namespace gsut
