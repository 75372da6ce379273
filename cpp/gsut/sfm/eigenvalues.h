// Eigenvalues of small real matrices, compiled once: Eigen's solver takes seconds for each size.
#pragma once

#include <Eigen/Core>
#include <complex>

namespace gsut {

// At most 10 x 10, without an allocation.
using SmallMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, 10, 10>;
using SmallComplexMatrix =
    Eigen::Matrix<std::complex<double>, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, 10, 10>;
using SmallComplexVector =
    Eigen::Matrix<std::complex<double>, Eigen::Dynamic, 1, Eigen::ColMajor, 10, 1>;

// The eigenvalues of a square matrix and, where vectors is not null, the eigenvectors in its
// columns. False if the iteration did not converge.
bool FindEigenvalues(const SmallMatrix& matrix, SmallComplexVector* values,
                     SmallComplexMatrix* vectors = nullptr);

}  // namespace gsut
