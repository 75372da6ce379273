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
  // held: component of the centre that does not change, or -1.
  explicit PoseManifold(int held = -1) : held_(held) {}
  int AmbientSize() const override { return 7; }
  int TangentSize() const override { return held_ < 0 ? kPoseTangent : kPoseTangent - 1; }

  bool Plus(const double* x, const double* delta, double* x_plus_delta) const override {
    Eigen::Matrix<double, kPoseTangent, 1> change = Eigen::Matrix<double, kPoseTangent, 1>::Zero();
    for (int i = 0, j = 0; i < kPoseTangent; ++i) {
      if (i != held_) change[i] = delta[j++];
    }
    PoseBlock sum;
    std::copy_n(x, sum.size(), sum.begin());
    AddToPose(change, &sum);
    std::copy_n(sum.begin(), sum.size(), x_plus_delta);
    return true;
  }

  bool PlusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, 7, Eigen::Dynamic, Eigen::RowMajor>> matrix(jacobian, 7,
                                                                                 TangentSize());
    matrix.setZero();
    for (int i = 0, j = 0; i < kPoseTangent; ++i) {
      if (i != held_) matrix(i, j++) = 1.0;
    }
    return true;
  }

  bool Minus(const double* y, const double* x, double* y_minus_x) const override {
    const Eigen::AngleAxisd turn(Eigen::Map<const Eigen::Quaterniond>(y) *
                                 Eigen::Map<const Eigen::Quaterniond>(x).conjugate());
    Eigen::Matrix<double, kPoseTangent, 1> change;
    change << CenterOf(y) - CenterOf(x), turn.angle() * turn.axis();
    for (int i = 0, j = 0; i < kPoseTangent; ++i) {
      if (i != held_) y_minus_x[j++] = change[i];
    }
    return true;
  }

  bool MinusJacobian(const double*, double* jacobian) const override {
    Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, 7, Eigen::RowMajor>> matrix(jacobian,
                                                                                 TangentSize(), 7);
    matrix.setZero();
    for (int i = 0, j = 0; i < kPoseTangent; ++i) {
      if (i != held_) matrix(j++, i) = 1.0;
    }
    return true;
  }

 private:
  int held_;
};

}  // namespace gsut
