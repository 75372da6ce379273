// Tests gsut/geometry: rigid transforms and their algebra; shutters are tested from Python.
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/base/rng.h"
#include "gsut/geometry/pose.h"
#include "gsut/geometry/shutter.h"  // Vector6d

namespace gsut {
namespace {

// Products of a few rotations in double; observed 6e-16.
constexpr double kRounding = 1e-14;
// A power series of 30 terms of a matrix of norm up to 5: e^5 eps; observed 9e-14.
constexpr double kSeries = 1e-12;

Vector6d RandomTwist(std::uint64_t stream, double angle) {
  const Rng rng(5, stream);
  Vector6d xi;
  for (int k = 0; k < 6; ++k) xi[k] = rng.Uniform(static_cast<std::uint64_t>(k)) - 0.5;
  xi.head<3>() *= 0.5 / xi.head<3>().norm();
  xi.tail<3>() *= angle / xi.tail<3>().norm();
  return xi;
}

// exp of the 4x4 matrix [[w]x v; 0 0] by its power series.
Eigen::Matrix4d SeriesExp(const Vector6d& xi) {
  Eigen::Matrix4d generator = Eigen::Matrix4d::Zero();
  generator.topLeftCorner<3, 3>() << 0, -xi[5], xi[4], xi[5], 0, -xi[3], -xi[4], xi[3], 0;
  generator.topRightCorner<3, 1>() = xi.head<3>();
  Eigen::Matrix4d sum = Eigen::Matrix4d::Identity();
  Eigen::Matrix4d term = Eigen::Matrix4d::Identity();
  for (int k = 1; k <= 40; ++k) {
    term = term * generator / k;
    sum += term;
  }
  return sum;
}

TEST(PoseTest, ExpMatchesThePowerSeriesAtAnyAngle) {
  for (const double angle :
       {1e-300, 1e-12, 1e-6, 0.9e-4, 1.1e-4, 0.01, 1.0, 3.0, std::numbers::pi, 5.0}) {
    for (std::uint64_t stream = 0; stream < 10; ++stream) {
      const Vector6d xi = RandomTwist(stream, angle);
      const Eigen::Matrix4d found = ExpPose(xi).Matrix();
      EXPECT_LT((found - SeriesExp(xi)).cwiseAbs().maxCoeff(), kSeries) << angle;
      const Eigen::Matrix3d r = found.topLeftCorner<3, 3>();
      EXPECT_LT((r.transpose() * r - Eigen::Matrix3d::Identity()).norm(), kRounding) << angle;
    }
  }
}

TEST(PoseTest, ProductAndInverseAreThoseOfTheMatrices) {
  for (std::uint64_t stream = 0; stream < 20; ++stream) {
    const Pose a = ExpPose(RandomTwist(stream, 2.0));
    const Pose b = ExpPose(RandomTwist(stream + 100, 1.0));
    EXPECT_LT(((a * b).Matrix() - a.Matrix() * b.Matrix()).norm(), kRounding);
    EXPECT_LT(((a * a.Inverse()).Matrix() - Eigen::Matrix4d::Identity()).norm(), kRounding);
    // The camera centre is what the pose takes to the origin.
    EXPECT_LT((a.rotation * a.CenterInSource() + a.translation).norm(), kRounding);
  }
}

TEST(PoseTest, FromMatrixKeepsAnExactRotationAndCleansARoundedOne) {
  const Eigen::Matrix4d exact = ExpPose(RandomTwist(3, 1.0)).Matrix();
  EXPECT_EQ(Pose::FromMatrix(exact).Matrix(), exact);
  // Five printed digits, as some files have.
  const Eigen::Matrix4d rounded = (exact * 1e5).array().round().matrix() / 1e5;
  Eigen::Matrix4d printed = rounded;
  printed.row(3) = Eigen::RowVector4d(0, 0, 0, 1);
  const Pose cleaned = Pose::FromMatrix(printed);
  EXPECT_LT((cleaned.rotation.transpose() * cleaned.rotation - Eigen::Matrix3d::Identity()).norm(),
            kRounding);
  EXPECT_LT((cleaned.rotation - exact.topLeftCorner<3, 3>()).norm(), 3e-5);
  EXPECT_EQ(cleaned.translation, Eigen::Vector3d(printed.topRightCorner<3, 1>()));
}

// The message of the InputError that FromMatrix throws; empty if none.
std::string ErrorOf(const Eigen::Matrix4d& matrix) {
  try {
    Pose::FromMatrix(matrix);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(PoseTest, FromMatrixRefusesWhatIsNoRigidTransform) {
  const Eigen::Matrix4d good = ExpPose(RandomTwist(4, 1.0)).Matrix();
  EXPECT_EQ(ErrorOf(good), "");
  Eigen::Matrix4d scaled = good, mirrored = good, sheared = good, projective = good;
  scaled.topLeftCorner<3, 3>() *= 1.001;
  mirrored.col(0) *= -1;
  sheared(0, 1) += 1e-3;
  projective(3, 0) = 0.5;
  EXPECT_NE(ErrorOf(scaled).find("rotation"), std::string::npos);
  EXPECT_NE(ErrorOf(mirrored).find("determinant"), std::string::npos);
  EXPECT_NE(ErrorOf(sheared).find("rotation"), std::string::npos);
  EXPECT_NE(ErrorOf(projective).find("last row"), std::string::npos);
  for (const double value :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    for (int k = 0; k < 16; ++k) {
      Eigen::Matrix4d bad = good;
      bad(k / 4, k % 4) = value;
      EXPECT_NE(ErrorOf(bad).find("finite"), std::string::npos) << k;
    }
  }
  EXPECT_NE(ErrorOf(Eigen::Matrix4d::Zero()), "");
}

}  // namespace
}  // namespace gsut
