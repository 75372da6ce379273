// Eigenvalues of small real matrices, by Eigen.
#include "gsut/sfm/eigenvalues.h"

#include <Eigen/Eigenvalues>

namespace gsut {

bool FindEigenvalues(const SmallMatrix& matrix, SmallComplexVector* values,
                     SmallComplexMatrix* vectors) {
  const Eigen::EigenSolver<SmallMatrix> solver(matrix, vectors != nullptr);
  if (solver.info() != Eigen::Success) return false;
  *values = solver.eigenvalues();
  if (vectors != nullptr) *vectors = solver.eigenvectors();
  return true;
}

}  // namespace gsut
