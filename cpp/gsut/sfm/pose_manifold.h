// The manifold of pose blocks for Ceres.
#pragma once

#include <ceres/manifold.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

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
    const Eigen::Vector3d turn = change.tail<3>();
    const double half = 0.5 * turn.norm();
    // sin(half) / (2 half), by its series where it would be 0 / 0.
    constexpr double kSmall = 1e-4;
    const double factor =
        half < kSmall ? 0.5 * (1.0 - half * half / 6.0) : 0.5 * std::sin(half) / half;
    const Eigen::Quaterniond step(std::cos(half), factor * turn.x(), factor * turn.y(),
                                  factor * turn.z());
    const Eigen::Map<const Eigen::Quaterniond> before(x);
    Eigen::Map<Eigen::Quaterniond> after(x_plus_delta);
    after = (step * before).normalized();
    for (int i = 0; i < 3; ++i) x_plus_delta[4 + i] = x[4 + i] + change[i];
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
