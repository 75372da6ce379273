// Rotation vectors and their derivatives.
#pragma once

#include <Eigen/Core>

namespace gsut {

// Skew(w) p = w x p.
Eigen::Matrix3d Skew(const Eigen::Vector3d& w);

// The rotation by |w| radians about w.
Eigen::Matrix3d RotationOfVector(const Eigen::Vector3d& w);

// The rotation vector of a rotation matrix, of length at most pi.
Eigen::Vector3d VectorOfRotation(const Eigen::Matrix3d& rotation);

// The left Jacobian J of SO(3), exp(w + d) = exp(J(w) d) exp(w) to first order, and its inverse
// (Chirikjian, "Stochastic Models, Information Theory, and Lie Groups", 2012). |w| < 2 pi.
Eigen::Matrix3d LeftJacobian(const Eigen::Vector3d& w);
Eigen::Matrix3d InverseLeftJacobian(const Eigen::Vector3d& w);

}  // namespace gsut
