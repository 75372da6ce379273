// Normal equations of many observations with the points eliminated, as all covariances need them.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace gsut {

// Eliminating points is marginalising them: at the minimum the covariance of the other unknowns is
// the inverse of the Schur complement of the points, times the variance of the residuals.

// Weighted derivatives of a residual by the pose of its body (an image, or a rig that several
// images are on), by what all bodies share, such as a lens, and by its point.
struct ObservationDerivatives {
  int body = 0;
  Eigen::Matrix<double, 2, Eigen::Dynamic> by_body;
  Eigen::Matrix<double, 2, Eigen::Dynamic> by_shared;  // no columns: nothing is shared
  Eigen::Matrix<double, 2, 3> by_point;
  Eigen::Matrix<double, Eigen::Dynamic, 3> cross;  // by_body^T by_point, while points go
};

// All observations in their order, and those of each point.
struct ObservationTable {
  std::vector<ObservationDerivatives> linear;
  std::vector<std::vector<int>> of_point;
};

// What is left without the points.
struct EliminatedPoints {
  Eigen::MatrixXd normal;       // lower triangle: unknowns of body 0, of body 1 ..., shared ones
  std::int64_t determined = 0;  // directions of points that their observations determine
};

// The Schur complement of the points. A direction of a point that its images leave open, such as
// the distance where all were taken from one place, takes nothing away.
// Args: bodies: their number; size: unknowns of each; shared: number of shared unknowns.
// The same bits on any number of threads.
EliminatedPoints EliminatePoints(ObservationTable table, int bodies, int size, int shared);

// What observations say of what all bodies share, with poses and points eliminated.
struct SharedInformation {
  Eigen::MatrixXd normal;  // of the shared unknowns; zeros where the bodies do not hold together
  std::int64_t determined = 0;  // directions that poses and points take up
};

// Args: prior: what is known beforehand of a body's unknowns, as the diagonal of their normal
//   equations; its length is the number of unknowns; held: unknowns of bodies that the gauge holds.
SharedInformation FindSharedInformation(ObservationTable table, int bodies,
                                        const Eigen::VectorXd& prior, const std::vector<int>& held,
                                        int shared);

}  // namespace gsut
