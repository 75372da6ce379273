// Tests gsut/geometry/shutter: names, times of lines, poses between two and their derivatives.
#include "gsut/geometry/shutter.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "gsut/base/errors.h"
#include "gsut/base/rng.h"

namespace gsut {
namespace {

// Central differences with a step of 1e-6: rounding over the step; observed 5e-10.
constexpr double kDifferences = 1e-8;

Vector6d RandomTwist(std::uint64_t stream, double shift, double turn) {
  const Rng rng(9, stream);
  Vector6d xi;
  for (int k = 0; k < 6; ++k) xi[k] = rng.Uniform(static_cast<std::uint64_t>(k)) - 0.5;
  xi.head<3>() *= shift / xi.head<3>().norm();
  xi.tail<3>() *= turn / xi.tail<3>().norm();
  return xi;
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
  int ran = 0;
  for (const char* name : {"top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"}) {
    for (const char* parity : {"", "gsplat"}) {
      const Shutter shutter = Shutter::Named(name, parity);
      for (int line = 0; line < shutter.NumLines(8, 6); ++line) {
        EXPECT_NEAR(shutter.PixelTime(line + 0.5, line + 0.5, 8, 6), shutter.LineTime(line, 8, 6),
                    1e-15);
        ++ran;
      }
    }
  }
  EXPECT_EQ(ran, 2 * (6 + 6 + 8 + 8));
  EXPECT_EQ(Shutter().NumLines(8, 6), 1);
  EXPECT_EQ(Shutter::Named("top_to_bottom", "gsplat").LineTime(0, 1, 1), 0.0);
}

TEST(ShutterTest, JacobianMatchesCentralDifferencesAtAnyTurn) {
  constexpr double kStep = 1e-6;
  int ran = 0;
  for (const double turn : {1e-12, 1e-4, 0.9e-3, 1.1e-3, 0.3, 2.0, 3.1}) {
    for (const char* parity : {"", "gsplat"}) {
      for (const double t : {0.0, 0.1, 0.5, 0.93, 1.0}) {
        const Pose start = ExpPose(RandomTwist(1, 2.0, 1.0));
        const Pose end = ExpPose(RandomTwist(2, 0.5, turn)) * start;
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
          ++ran;
        }
      }
    }
  }
  EXPECT_EQ(ran, 7 * 2 * 5 * 6);
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
