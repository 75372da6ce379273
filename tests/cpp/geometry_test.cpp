// Tests gsut/geometry: rigid transforms and their algebra; shutters, and poses between two.
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/base/rng.h"
#include "gsut/geometry/pose.h"
#include "gsut/geometry/shutter.h"

namespace gsut {
namespace {

// Products of a few rotations in double; observed 6e-16.
constexpr double kRounding = 1e-14;
// A power series of 30 terms of a matrix of norm up to 5: e^5 eps; observed 9e-14.
constexpr double kSeries = 1e-12;
// Central differences with a step of 1e-6: rounding over the step; observed 5e-10.
constexpr double kDifferences = 1e-8;

Vector6d RandomTwist(std::uint64_t stream, double angle, double shift = 0.5) {
  const Rng rng(5, stream);
  Vector6d xi;
  for (int k = 0; k < 6; ++k) xi[k] = rng.Uniform(static_cast<std::uint64_t>(k)) - 0.5;
  xi.head<3>() *= shift / xi.head<3>().norm();
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

TEST(PoseTest, ExpOfZeroIsTheIdentity) {
  EXPECT_EQ(ExpPose(Vector6d::Zero()).Matrix(), Eigen::Matrix4d::Identity());
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

TEST(PoseTest, InterpolateMeetsItsEndsAndTurnsEvenly) {
  const Pose start = ExpPose(RandomTwist(1, 0.5));
  const Vector6d turn = RandomTwist(2, 1.2);
  Pose end = ExpPose(turn) * start;
  end.translation = Eigen::Vector3d(1, 2, 3);
  EXPECT_LT((Interpolate(start, end, 0.0).Matrix() - start.Matrix()).norm(), kRounding);
  EXPECT_LT((Interpolate(start, end, 1.0).Matrix() - end.Matrix()).norm(), kRounding);
  for (const double t : {0.1, 0.25, 0.5, 0.9}) {
    const Pose middle = Interpolate(start, end, t);
    Vector6d part = Vector6d::Zero();
    part.tail<3>() = t * turn.tail<3>();
    const Eigen::Matrix3d expected = ExpPose(part).rotation * start.rotation;
    EXPECT_LT((middle.rotation - expected).norm(), kRounding);
    const Eigen::Vector3d place = (1 - t) * start.translation + t * end.translation;
    EXPECT_LT((middle.translation - place).norm(), kRounding);
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

// The left perturbation that takes `from` to `to`, both nearly the same.
Vector6d Difference(const Pose& from, const Pose& to) {
  const Pose step = to * from.Inverse();
  Vector6d xi;
  xi.head<3>() = step.translation;
  xi.tail<3>() << 0.5 * (step.rotation(2, 1) - step.rotation(1, 2)),
      0.5 * (step.rotation(0, 2) - step.rotation(2, 0)),
      0.5 * (step.rotation(1, 0) - step.rotation(0, 1));
  return xi;
}

TEST(ShutterTest, NamesAreKnownOrRefused) {
  for (const char* name :
       {"global", "top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"}) {
    EXPECT_EQ(Shutter::Named(name).DirectionName(), name);
  }
  EXPECT_THROW(Shutter::Named("sideways"), InputError);
  EXPECT_THROW(Shutter::Named("global", "colmap"), InputError);
}

TEST(ShutterTest, PixelTimeOfALineIsItsTime) {
  for (const char* name : {"top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"}) {
    for (const char* parity : {"", "gsplat"}) {
      const Shutter shutter = Shutter::Named(name, parity);
      for (int line = 0; line < shutter.NumLines(8, 6); ++line) {
        EXPECT_NEAR(shutter.PixelTime(line + 0.5, line + 0.5, 8, 6), shutter.LineTime(line, 8, 6),
                    1e-15);
      }
    }
  }
  EXPECT_EQ(Shutter().NumLines(8, 6), 1);
  EXPECT_EQ(Shutter::Named("top_to_bottom", "gsplat").LineTime(0, 1, 1), 0.0);
}

TEST(ShutterTest, JacobianMatchesCentralDifferencesAtAnyTurn) {
  constexpr double kStep = 1e-6;
  for (const double turn : {1e-12, 1e-4, 0.9e-3, 1.1e-3, 0.3, 2.0, 3.1}) {
    for (const char* parity : {"", "gsplat"}) {
      for (const double t : {0.0, 0.1, 0.5, 0.93, 1.0}) {
        const Pose start = ExpPose(RandomTwist(1, 1.0, 2.0));
        const Pose end = ExpPose(RandomTwist(2, turn, 0.5)) * start;
        const CameraMotion motion(start, end, Shutter::Named("top_to_bottom", parity));
        const MotionJacobian found = motion.JacobianAt(t);
        for (int k = 0; k < 6; ++k) {
          const Vector6d xi = kStep * Vector6d::Unit(k);
          const Pose plus = ExpPose(xi), minus = ExpPose(-xi);
          const CameraMotion a(plus * start, end, motion.shutter),
              b(minus * start, end, motion.shutter), c(start, plus * end, motion.shutter),
              d(start, minus * end, motion.shutter);
          const Pose here = motion.At(t);
          const Vector6d of_start =
              (Difference(here, a.At(t)) - Difference(here, b.At(t))) / (2 * kStep);
          const Vector6d of_end =
              (Difference(here, c.At(t)) - Difference(here, d.At(t))) / (2 * kStep);
          EXPECT_LT((found.from_start.col(k) - of_start).norm(), kDifferences) << turn << " " << t;
          EXPECT_LT((found.from_end.col(k) - of_end).norm(), kDifferences) << turn << " " << t;
        }
      }
    }
  }
}

TEST(ShutterTest, StillCameraIsOnePose) {
  const Pose pose = ExpPose(RandomTwist(3, 1.0, 1.0));
  const CameraMotion motion(pose);
  EXPECT_TRUE(motion.shutter.IsGlobal());
  EXPECT_EQ(motion.Middle().rotation, pose.rotation);
  EXPECT_EQ(motion.JacobianAt(0.0).from_start, Matrix6d::Identity());
  EXPECT_EQ(motion.JacobianAt(0.0).from_end, Matrix6d::Zero());
}

}  // namespace
}  // namespace gsut
