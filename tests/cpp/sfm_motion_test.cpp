// Cameras that move during the readout, and cameras on rigs: derivatives and bundle adjustment.
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <chrono>
#include <stdexcept>
#include <thread>
#include <utility>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/interrupt.h"
#include "gsut/sfm/bundle.h"
#include "gsut/sfm/bundle_state.h"
#include "gsut/sfm/lens_evaluation.h"
#include "gsut/geometry/camera_chain.h"
#include "gsut/geometry/pose_block.h"
#include "gsut/geometry/rotation_vector.h"
#include "synthetic_bundle.h"

namespace gsut {
namespace {

// Central differences in double, relative to the largest derivative; worst 3.2e-11.
constexpr double kDifferences = 6e-11;
// Exact data: where Levenberg-Marquardt stops, which is not yet rounding; worst 1.1e-8.
constexpr double kExact = 2e-8;
// Radians: what pixels leave of a turn that is stated a thousand times more exactly; worst 1e-5.
constexpr double kTurned = 2e-5;
// Some units in the last place; worst 1.3e-15.
constexpr double kRounding = 2.6e-15;

Velocity RandomVelocity(Numbers* numbers, double shift, double turn) {
  Velocity velocity;
  velocity << shift * numbers->Vector(), turn * numbers->Vector();
  return velocity;
}

// The first two coordinates in the camera, linear: dout_dp is known exactly.
Eigen::Vector2d Output(const CameraChain& chain, const Eigen::Vector3d& point,
                       const Eigen::Matrix<double, 2, 3>& dout_dp) {
  return dout_dp * chain.Point(point);
}

TEST(CameraChain, DerivativesAgreeWithCentralDifferences) {
  constexpr double kStep = 1e-5;
  Numbers numbers(41);
  for (int i = 0; i < 40; ++i) {
    PoseBlock pose = ToBlock(numbers.RandomPose(1.0));
    PoseBlock mount = ToBlock(numbers.RandomPose(0.3));
    Velocity velocity = RandomVelocity(&numbers, 0.3, i % 4 == 0 ? 1e-6 : 0.4);
    Eigen::Vector3d point = 3.0 * numbers.Vector();
    Eigen::Matrix<double, 2, 3> dout_dp;
    dout_dp << numbers.Vector().transpose(), numbers.Vector().transpose();
    const CameraChain chain = {pose.data(), i % 3 == 0 ? nullptr : velocity.data(),
                               i % 2 == 0 ? nullptr : mount.data(), numbers.Uniform(-0.5, 0.5)};
    const ChainDerivatives by = Derivatives(chain, point, dout_dp);
    const auto out = [&] { return Output(chain, point, dout_dp); };
    const double bound = kDifferences * (1.0 + by.by_pose.norm());
    const auto plain = [&](double* values, int count, const auto& expected) {
      for (int k = 0; k < count; ++k) {
        const double kept = values[k];
        values[k] = kept + kStep;
        const Eigen::Vector2d after = out();
        values[k] = kept - kStep;
        const Eigen::Vector2d before = out();
        values[k] = kept;
        EXPECT_LT(((after - before) / (2 * kStep) - expected.col(k)).norm(), bound) << k;
      }
    };
    const auto turned = [&](PoseBlock* block, const auto& expected) {
      const PoseBlock kept = *block;
      for (int k = 0; k < 6; ++k) {
        Eigen::Matrix<double, 6, 1> change = Eigen::Matrix<double, 6, 1>::Zero();
        Eigen::Vector2d sides[2];
        for (int side = 0; side < 2; ++side) {
          change[k] = side == 0 ? kStep : -kStep;
          *block = kept;
          AddToPose(change, block);
          sides[side] = out();
        }
        *block = kept;
        EXPECT_LT(((sides[0] - sides[1]) / (2 * kStep) - expected.col(k)).norm(), bound) << k;
      }
    };
    plain(point.data(), 3, by.by_point);
    turned(&pose, by.by_pose);
    if (chain.velocity != nullptr) plain(velocity.data(), 6, by.by_velocity);
    if (chain.mount != nullptr) turned(&mount, by.by_mount);
  }
}

TEST(CameraChain, MovesAsTheShutterOfTheRendererDoes) {
  Numbers numbers(42);
  for (int i = 0; i < 10; ++i) {
    const Pose middle = numbers.RandomPose(1.0);
    const Velocity velocity = RandomVelocity(&numbers, 0.3, 0.2);
    const CameraMotion motion(MovedPose(middle, velocity, -0.5), MovedPose(middle, velocity, 0.5),
                              Shutter::Named("top_to_bottom"));
    for (const double t : {0.0, 0.2, 0.5, 0.9, 1.0}) {
      const Pose expected = motion.At(t), found = MovedPose(middle, velocity, t - 0.5);
      EXPECT_LT((expected.Matrix() - found.Matrix()).norm(), kRounding);
    }
    EXPECT_LT((VelocityBetween(motion.start, motion.end) - velocity).norm(), kRounding);
  }
}

// A walk whose cameras turn by some 9 degrees and move while they read.
Bundle MovingBundle(int images, int points, std::uint64_t stream) {
  Bundle bundle = MakeBundle(WideLens(), images, points, stream);
  Numbers numbers(stream + 1);
  for (int i = 0; i < images; ++i) {
    bundle.velocities.push_back(RandomVelocity(&numbers, 0.1, 0.09));
  }
  ObserveAll(&bundle);
  return bundle;
}

TEST(AdjustBundle, PriorsHoldVelocitiesThatNothingTells) {
  Bundle bundle = MovingBundle(4, 100, 45);
  for (BundleObservation& observation : bundle.observations) observation.time = 0.0;
  BundleOptions options;
  options.gauge_image = 0;
  options.scale_image = 3;
  VelocityPrior prior;
  prior.mean << 0.1, 0.2, 0.3, 0.01, 0.02, 0.03;
  prior.sigma.setConstant(0.1);
  options.velocity_priors.assign(4, prior);
  AdjustBundle(&bundle, options);
  for (const Velocity& velocity : bundle.velocities) {
    EXPECT_LT((velocity - prior.mean).norm(), kRounding);
  }
}

// One camera may turn, over points that stay: a turn stated much more exactly than pixels are seen
// decides, unless the gyroscope's calibration takes it up.
TEST(AdjustBundle, TurnPriorsDecideUnlessTheirCalibrationIsOpen) {
  const Bundle exact = MakeBundle(WideLens(), 3, 60, 77);
  const auto rotation = [](const Bundle& bundle, int first, int second) {
    return Eigen::Matrix3d(bundle.camera_from_world[second].rotation *
                           bundle.camera_from_world[first].rotation.transpose());
  };
  const Eigen::Matrix3d off = RotationOfVector({0.002, -0.003, 0.001});
  BundleOptions options;
  options.through_lens = true;
  options.function_tolerance = 1e-14;
  options.point_fixed.assign(exact.points.size(), 1);
  options.image_fixed = {1, 0, 1};
  TurnPrior& turn = options.turn_priors.emplace_back();
  turn.first = 0;
  turn.second = 1;
  turn.rotation = off * rotation(exact, 0, 1);
  turn.by_calibration = Eigen::Matrix3d::Identity();
  turn.sigma = 1e-5;
  for (const double open : {1e-9, 1e3}) {
    options.calibration_sigma = Eigen::Vector3d::Constant(open);
    for (const bool is_second : {true, false}) {
      Bundle bundle = exact;
      if (!is_second) {
        std::swap(turn.first, turn.second);
        turn.rotation = off * rotation(exact, 1, 0);
      }
      AdjustBundle(&bundle, options);
      const Eigen::Matrix3d left =
          rotation(bundle, turn.first, turn.second) *
          (open < 1.0 ? turn.rotation : rotation(exact, turn.first, turn.second)).transpose();
      EXPECT_LT(VectorOfRotation(left).norm(), kTurned) << open << is_second;
      if (!is_second) {
        std::swap(turn.first, turn.second);
        turn.rotation = off * rotation(exact, 0, 1);
      }
    }
  }
}

// A survey states some points in another world, a thousand times more exactly than pixels are seen:
// all goes there.
TEST(AdjustBundle, PointPriorsMoveAllToTheirWorld) {
  const Bundle exact = MakeBundle(WideLens(), 4, 60, 79);
  const Eigen::Matrix3d turn = RotationOfVector({0.01, -0.02, 0.015});
  const auto moved = [&](const Eigen::Vector3d& point) {
    return Eigen::Vector3d(1.02 * turn * point + Eigen::Vector3d(0.1, -0.2, 0.3));
  };
  BundleOptions options;
  options.through_lens = true;
  options.function_tolerance = 1e-14;
  for (const int point : {3, 17, 29, 41}) {
    options.point_priors.push_back(
        {point, moved(exact.points[point]), Eigen::Vector3d::Constant(1e-3)});
  }
  Bundle bundle = exact;
  AdjustBundle(&bundle, options);
  for (int i = 0; i < 4; ++i) {
    EXPECT_LT((bundle.camera_from_world[i].CenterInSource() -
               moved(exact.camera_from_world[i].CenterInSource()))
                  .norm(),
              kTurned);
  }
  options.point_priors[0].point = 60;
  EXPECT_THROW(AdjustBundle(&bundle, options), InputError);
  options.point_priors[0] = {3, Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
  EXPECT_THROW(AdjustBundle(&bundle, options), InputError);
}

TEST(AdjustBundle, RefusesTurnsThatDoNotFit) {
  Bundle bundle = MakeBundle(WideLens(), 3, 60, 78);
  BundleOptions options;
  options.calibration_sigma = Eigen::Vector3d::Ones();
  TurnPrior& turn = options.turn_priors.emplace_back();
  turn.second = 1;
  EXPECT_THROW(AdjustBundle(&bundle, options), InputError);  // no column for the calibration
  turn.by_calibration = Eigen::Matrix3d::Identity();
  turn.second = 3;
  EXPECT_THROW(AdjustBundle(&bundle, options), InputError);
  turn.second = 0;
  EXPECT_THROW(AdjustBundle(&bundle, options), InputError);
}

TEST(PoseCovariances, GrowWithVelocitiesToEstimate) {
  Bundle bundle = MovingBundle(4, 80, 46);
  Numbers numbers(47);
  for (BundleObservation& o : bundle.observations) {
    o.pixel += 0.3 * Eigen::Vector2d(numbers.Normal(), numbers.Normal());
    std::vector<std::uint8_t> has_ray;
    o.bearing = MakeBearings(bundle.cameras[0], std::span(&o.pixel, 1), &has_ray)[0];
  }
  BundleOptions options;
  options.gauge_image = 0;
  options.scale_image = 3;
  options.loss_scale = 0.0;
  AdjustBundle(&bundle, options);
  const auto moving = PoseCovariances(bundle, options);
  // The same with velocities known so well that they are no unknowns.
  VelocityPrior known;
  known.sigma.setConstant(1e-9);
  options.velocity_priors.assign(4, known);
  const auto held = PoseCovariances(bundle, options);
  for (int k = 0; k < 6; ++k) EXPECT_GT(moving[2](k, k), held[2](k, k)) << k;
}

TEST(PoseCovariances, OfManyBodiesAreThoseOfFew) {
  constexpr double kBound = 7e-7;  // relative
  constexpr int kMany = 120;       // bodies whose inverse is made in parts
  for (const bool moves : {false, true}) {
    Bundle few = MovingBundle(5, 150, 48);
    if (!moves) few.velocities.clear();
    Bundle many = few;
    BundleOptions options;
    options.gauge_image = 0;
    options.scale_image = 4;
    if (moves) {
      VelocityPrior known;
      known.sigma.setConstant(0.02);
      options.velocity_priors.assign(kMany, known);
    }
    options.image_fixed.assign(kMany, 1);
    std::fill_n(options.image_fixed.begin(), 5, 0);
    while (many.camera_from_world.size() < kMany) {
      many.camera_of_image.push_back(0);
      many.camera_from_world.emplace_back();
      if (moves) many.velocities.emplace_back(Velocity::Zero());
    }
    const auto in_parts = PoseCovariances(many, options);
    options.image_fixed.clear();
    if (moves) options.velocity_priors.resize(5);
    const auto whole = PoseCovariances(few, options);
    for (int image = 1; image < 5; ++image) {
      EXPECT_GT(whole[image].norm(), 0.0);
      EXPECT_LT((in_parts[image] - whole[image]).norm(), kBound * whole[image].norm())
          << image << moves;
    }
  }
}

TEST(ObservationResidual, DerivativesOnARigAgreeWithCentralDifferences) {
  constexpr double kStep = 1e-5;
  constexpr double kBound = 7.6e-11;  // relative to the largest derivative; worst 3.8e-11
  Bundle bundle = RigBundle(200, 47);
  Disturb(&bundle, 46);
  BundleState state(bundle);
  int mounted = 0, compared = 0;
  for (const bool through_lens : {false, true}) {
    LensEvaluation evaluation(bundle, state, {});
    for (int i = 0; i < static_cast<int>(bundle.observations.size()); i += 37) {
      const auto evaluated = [&] {
        ObservationResidual out;
        evaluation.Evaluate();
        EXPECT_TRUE(
            EvaluateObservation(bundle, state, i, through_lens ? &evaluation : nullptr, &out));
        return out;
      };
      const ChainDerivatives by = evaluated().by;
      const int image = bundle.observations[i].image, mount = state.mount_of_image[image];
      const bool on_mount = mount >= 0;
      mounted += on_mount;
      const double largest =
          std::max({1.0, by.by_pose.cwiseAbs().maxCoeff(), by.by_point.cwiseAbs().maxCoeff(),
                    on_mount ? by.by_mount.cwiseAbs().maxCoeff() : 0.0});
      const auto compare = [&](auto* values, int count, const auto& expected, const auto& add) {
        const auto kept = *values;
        for (int k = 0; k < count; ++k) {
          Eigen::Vector2d sides[2];
          for (int side = 0; side < 2; ++side) {
            *values = kept;
            add(k, side == 0 ? kStep : -kStep);
            sides[side] = evaluated().residual;
          }
          *values = kept;
          EXPECT_LT(((sides[0] - sides[1]) / (2 * kStep) - expected.col(k)).norm(),
                    kBound * largest);
          ++compared;
        }
      };
      const auto compare_pose = [&](PoseBlock* pose, const auto& expected) {
        compare(pose, kPoseTangent, expected, [&](int k, double step) {
          AddToPose(step * Eigen::Matrix<double, kPoseTangent, 1>::Unit(k), pose);
        });
      };
      compare_pose(&state.poses[state.body_of_image[image]], by.by_pose);
      if (on_mount) compare_pose(&state.mounts[mount], by.by_mount);
      Eigen::Vector3d& point = state.points[bundle.observations[i].point];
      compare(&point, 3, by.by_point, [&](int k, double step) { point[k] += step; });
    }
  }
  EXPECT_GT(mounted, 10);
  EXPECT_GT(compared, 500);
}

TEST(AdjustBundle, RigHasItsBaselinesScale) {
  const Bundle truth = RigBundle(200, 48);
  Bundle bundle = truth;
  Disturb(&bundle, 49);
  BundleOptions options;
  options.gauge_image = 0;  // the rig's baseline holds the scale
  options.through_lens = true;
  options.loss_scale = 0.0;
  options.function_tolerance = 1e-16;
  const BundleSummary summary = AdjustBundle(&bundle, options);
  EXPECT_LT(LengthOf(summary.cost_after, bundle), kExact);
  for (int i = 0; i < 8; ++i) {
    EXPECT_LT((bundle.camera_from_world[i].Matrix() - truth.camera_from_world[i].Matrix()).norm(),
              kExact);
  }
  const auto covariances = PoseCovariances(bundle, options);  // determined, with no scale held
  EXPECT_GT(covariances[7].trace(), 0.0);
}

TEST(AdjustBundle, RefusesMotionsAndRigsThatDoNotFit) {
  Bundle bundle = RigBundle(200, 52);
  bundle.mount_of_image[1] = 1;
  EXPECT_THROW(AdjustBundle(&bundle, {}), InputError);
  bundle = RigBundle(200, 52);
  bundle.body_of_image[7] = 6;  // bodies 4 and 5 have no image
  EXPECT_THROW(AdjustBundle(&bundle, {}), InputError);
  bundle = RigBundle(200, 52);
  bundle.velocities.resize(3, Velocity::Zero());
  EXPECT_THROW(AdjustBundle(&bundle, {}), InputError);
}

TEST(AdjustBundle, InterruptEndsItAndLeavesTheBundleAsItWas) {
  Bundle bundle = MakeBundle(WideLens(), 4, 100, 47);
  Disturb(&bundle, 48);
  const std::vector<Eigen::Vector3d> points = bundle.points;
  const InterruptCheck check([] { return std::make_exception_ptr(std::runtime_error("ended")); });
  std::this_thread::sleep_for(std::chrono::milliseconds(150));  // until it asks
  EXPECT_THROW(AdjustBundle(&bundle, {}), std::runtime_error);
  EXPECT_EQ(bundle.points, points);
}

}  // namespace
}  // namespace gsut
