// The manifold of pose blocks for Ceres.
#pragma once

#include <ceres/manifold.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>

#include "gsut/geometry/pose_block.h"

namespace gsut {

class PoseManifold : public ceres::Manifold {
 public:
  int AmbientSize() const override { return kSize; }
  int TangentSize() const override { return kPoseTangent; }

  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override {
    PoseBlock sum;
    std::copy_n(x, kSize, sum.begin());
    AddToPose(Eigen::Map<const Tangent>(delta), &sum);
    std::copy_n(sum.begin(), kSize, x_plus_delta);
    return true;
  }

  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, kSize, kPoseTangent, Eigen::RowMajor>>{jacobian}.setIdentity();
    return true;
  }

  bool Minus(const double* y, const double* x, double* y_minus_x) const override {
    const Eigen::AngleAxisd turn(Eigen::Map<const Eigen::Quaterniond>(y) *
                                 Eigen::Map<const Eigen::Quaterniond>(x).conjugate());
    Eigen::Map<Tangent>{y_minus_x} << CenterOf(y) - CenterOf(x), turn.angle() * turn.axis();
    return true;
  }

  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, kPoseTangent, kSize, Eigen::RowMajor>>{jacobian}.setIdentity();
    return true;
  }

 private:
  static constexpr int kSize = 7;
  using Tangent = Eigen::Matrix<double, kPoseTangent, 1>;
};

}  // namespace gsut
