// Geometry of structure from motion: minimal solvers, RANSAC, points, bundle adjustment.
#include <gtest/gtest.h>
#include <hwy/targets.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <set>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/isa.h"
#include "gsut/base/rng.h"
#include "gsut/sfm/absolute_pose.h"
#include "gsut/sfm/bundle.h"
#include "gsut/sfm/minimal_solvers.h"
#include "gsut/sfm/match.h"
#include "gsut/sfm/relative_pose.h"
#include "gsut/sfm/sampler.h"
#include "gsut/sfm/ceres_settings.h"
#include "gsut/sfm/structure.h"
#include "gsut/sfm/triangulate.h"
#include "synthetic_bundle.h"

namespace gsut {
namespace {

// Epipolar residual of a minimal solution, rays of unit length: units in the last place; worst
// 5.2e-16.
constexpr double kMinimalResidual = 1e-15;
// Distance of the best of a minimal solver's solutions to the truth, in 300 random problems each:
// five points, worst 1.6e-8 (GCC) and 8.2e-8 (clang for Windows); three points, worst 1.8e-12.
constexpr double kFivePointTruth = 2e-7;
constexpr double kThreePointTruth = 1e-10;
// Central differences in double, relative; worst 1.3e-9.
constexpr double kDifferences = 2.6e-9;
// Exact data: where Levenberg-Marquardt stops, which is not yet rounding; worst 1.0e-7.
constexpr double kExact = 2e-7;

// The bearing of a point in the camera frame, displaced by some pixels.
Bearing See(const Camera& camera, const Eigen::Vector3d& point,
            const Eigen::Vector2d& displacement = Eigen::Vector2d::Zero()) {
  Eigen::Vector2d pixel;
  std::uint8_t valid = 0;
  camera.Project(1, point.data(), pixel.data(), &valid);
  EXPECT_TRUE(valid);
  pixel += displacement;
  std::vector<std::uint8_t> has_ray;
  const auto bearings = MakeBearings(camera, std::span(&pixel, 1), &has_ray);
  EXPECT_TRUE(has_ray[0]);
  return bearings[0];
}

// A point that a camera with WideLens sees, up to 95 degrees off the axis.
Eigen::Vector3d PointInView(Numbers* numbers) {
  const double angle = numbers->Uniform(0.0, 95.0) * std::numbers::pi / 180.0;
  const double around = numbers->Uniform(0.0, 2.0 * std::numbers::pi);
  return numbers->Uniform(2.0, 6.0) * Eigen::Vector3d(std::sin(angle) * std::cos(around),
                                                      std::sin(angle) * std::sin(around),
                                                      std::cos(angle));
}

TEST(Bearing, ResidualIsTheReprojectionErrorToFirstOrder) {
  Numbers numbers(1);
  const Camera camera = WideLens();
  for (int i = 0; i < 200; ++i) {
    const Eigen::Vector3d point = PointInView(&numbers);
    const Eigen::Vector2d error = 1e-3 * Eigen::Vector2d(numbers.Normal(), numbers.Normal());
    const Eigen::Vector2d residual = BearingResidual(See(camera, point, error), point);
    EXPECT_LT((residual + error).norm(), 1e-4 * error.norm());
  }
}

TEST(Bearing, ResidualDerivativeAgreesWithDifferences) {
  Numbers numbers(2);
  const Camera camera = WideLens();
  for (int i = 0; i < 200; ++i) {
    const Bearing bearing = See(camera, PointInView(&numbers));
    const Eigen::Vector3d point = 3.0 * numbers.Ray();  // anywhere, also far behind the bearing
    if (bearing.ray.dot(point.normalized()) < -0.95) continue;
    Eigen::Matrix<double, 2, 3> jacobian, differences;
    BearingResidual(bearing, point, &jacobian);
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d step = 1e-6 * Eigen::Vector3d::Unit(k);
      differences.col(k) =
          (BearingResidual(bearing, point + step) - BearingResidual(bearing, point - step)) / 2e-6;
    }
    EXPECT_LT((jacobian - differences).norm(), kDifferences * (1.0 + jacobian.norm()));
  }
}

TEST(FivePoint, FindsTheTruthAmongItsSolutionsAllAroundTheSphere) {
  Numbers numbers(3);
  double worst = 0.0;
  for (int problem = 0; problem < 300; ++problem) {
    Pose pose = numbers.RandomPose(1.0);
    pose.translation.normalize();
    std::array<Eigen::Vector3d, 5> rays1, rays2;
    for (int i = 0; i < 5; ++i) {
      const Eigen::Vector3d point = 4.0 * numbers.Vector();
      rays1[i] = point.normalized();
      rays2[i] = (pose.rotation * point + pose.translation).normalized();
    }
    const Eigen::Matrix3d truth = EssentialMatrix(pose);
    double nearest = 10.0;
    for (const Eigen::Matrix3d& e : FivePoint(rays1, rays2)) {
      for (int i = 0; i < 5; ++i) EXPECT_LT(std::abs(rays2[i].dot(e * rays1[i])), kMinimalResidual);
      nearest = std::min({nearest, (e - truth).norm(), (e + truth).norm()});
    }
    worst = std::max(worst, nearest);
  }
  EXPECT_LT(worst, kFivePointTruth);
}

TEST(ThreePoint, FindsTheTruthAmongItsSolutionsAllAroundTheSphere) {
  Numbers numbers(4);
  double worst = 0.0;
  for (int problem = 0; problem < 300; ++problem) {
    const Pose truth = numbers.RandomPose(2.0);
    std::array<Eigen::Vector3d, 3> rays, points;
    for (int i = 0; i < 3; ++i) {
      points[i] = 3.0 * numbers.Vector();
      rays[i] = (truth.rotation * points[i] + truth.translation).normalized();
    }
    const auto poses = ThreePoint(rays, points);
    EXPECT_LE(poses.size(), 4U);
    double nearest = 10.0;
    for (const Pose& pose : poses) {
      nearest = std::min(nearest, (pose.Matrix() - truth.Matrix()).norm());
    }
    worst = std::max(worst, nearest);
  }
  EXPECT_LT(worst, kThreePointTruth);
}

TEST(ThreePoint, CollinearPointsGiveNothing) {
  const std::array<Eigen::Vector3d, 3> points = {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0, 0, 2),
                                                 Eigen::Vector3d(0, 0, 3)};
  const std::array<Eigen::Vector3d, 3> rays = {Eigen::Vector3d::UnitX(), Eigen::Vector3d::UnitY(),
                                               Eigen::Vector3d::UnitZ()};
  EXPECT_TRUE(ThreePoint(rays, points).empty());
}

struct TwoViews {
  Pose second_from_first;
  std::vector<Bearing> first, second;
  int num_good = 0;
};

// Two views of points around, some matches wrong.
TwoViews MakeTwoViews(std::uint64_t stream, int count, int wrong, double noise, double baseline) {
  Numbers numbers(stream);
  const Camera camera = WideLens();
  TwoViews views;
  Eigen::Matrix<double, 6, 1> twist;
  twist << 0, 0, 0, 0.1 * numbers.Vector();
  views.second_from_first = ExpPose(twist);
  views.second_from_first.translation = baseline * numbers.Ray();
  const auto displaced = [&] {
    return Eigen::Vector2d(noise * Eigen::Vector2d(numbers.Normal(), numbers.Normal()));
  };
  while (static_cast<int>(views.first.size()) < count) {
    const Eigen::Vector3d point = PointInView(&numbers);
    const Eigen::Vector3d there =
        views.second_from_first.rotation * point + views.second_from_first.translation;
    if (std::atan2(std::hypot(there.x(), there.y()), there.z()) > 1.66) continue;
    views.first.push_back(See(camera, point, displaced()));
    const bool good = static_cast<int>(views.first.size()) > wrong;
    views.second.push_back(See(camera, good ? there : PointInView(&numbers), displaced()));
  }
  views.num_good = count - wrong;
  return views;
}

TEST(RelativePose, FindsThePoseThroughAWideLensWithHalfTheMatchesWrong) {
  const TwoViews views = MakeTwoViews(5, 400, 200, 0.3, 0.8);
  const RelativePose found = EstimateRelativePose(views.first, views.second, {});
  ASSERT_TRUE(found.found);
  EXPECT_GE(found.num_inliers, 195);
  EXPECT_LE(found.num_inliers, 230);
  const Eigen::AngleAxisd turn(found.second_from_first.rotation *
                               views.second_from_first.rotation.transpose());
  // A baseline of 0.8 seen over depths of 2 to 6: turn and translation trade against each other;
  // worst 1.9e-3. Better proof: it fits the matches at least as well as the truth does.
  EXPECT_LT(std::abs(turn.angle()), 4e-3);
  EXPECT_GT(
      found.second_from_first.translation.dot(views.second_from_first.translation.normalized()),
      1.0 - 5e-5);  // worst 2.2e-5
  Pose unit = views.second_from_first;
  unit.translation.normalize();
  const auto cost = [&](const Pose& pose) {
    double sum = 0.0;
    for (std::size_t i = 0; i < views.first.size(); ++i) {
      const double error = EpipolarError(EssentialMatrix(pose), views.first[i], views.second[i]);
      sum += std::min(error * error, 4.0);  // the default largest error, squared
    }
    return sum;
  };
  EXPECT_LE(cost(found.second_from_first), cost(unit));
  EXPECT_LT(found.num_rotation_inliers, found.num_inliers / 2);
}

TEST(RelativePose, RotationIsReportedAsRotation) {
  const TwoViews views = MakeTwoViews(6, 300, 50, 0.3, 0.0);
  const RelativePose found = EstimateRelativePose(views.first, views.second, {});
  ASSERT_TRUE(found.found);
  EXPECT_GT(found.num_rotation_inliers, 0.95 * found.num_inliers);
}

TEST(RelativePose, FewMatchesGiveNothing) {
  const TwoViews views = MakeTwoViews(7, 7, 0, 0.0, 0.8);
  EXPECT_FALSE(EstimateRelativePose(views.first, views.second, {}).found);
}

TEST(AbsolutePose, FindsThePoseThroughAWideLensWithHalfThePointsWrong) {
  Numbers numbers(8);
  const Camera camera = WideLens();
  const Pose truth = numbers.RandomPose(3.0);
  const Pose world_from_camera = truth.Inverse();
  std::vector<Bearing> bearings;
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 300; ++i) {
    const Eigen::Vector3d point = PointInView(&numbers);
    const Eigen::Vector2d noise = 0.3 * Eigen::Vector2d(numbers.Normal(), numbers.Normal());
    bearings.push_back(See(camera, i < 150 ? point : PointInView(&numbers), noise));
    points.push_back(world_from_camera.rotation * point + world_from_camera.translation);
  }
  const AbsolutePose found = EstimateAbsolutePose(bearings, points, {});
  EXPECT_GE(found.num_inliers, 150);
  EXPECT_LE(found.num_inliers, 160);
  const Pose difference = found.camera_from_world * world_from_camera;
  EXPECT_LT(std::abs(Eigen::AngleAxisd(difference.rotation).angle()), 5e-4);  // worst 3.3e-4
  EXPECT_LT(difference.translation.norm(), 1.1e-3);                           // worst 5.5e-4
}

TEST(Triangulate, FindsPointsBehindTheCameraPlaneAndDropsAWrongSight) {
  Numbers numbers(9);
  const Camera camera = WideLens();
  std::vector<Pose> poses(4);
  for (int i = 0; i < 4; ++i) poses[i].translation = Eigen::Vector3d(0.5 * i, 0.1 * i * i, 0);
  int checked = 0;
  for (int trial = 0; trial < 100; ++trial) {
    const Eigen::Vector3d point = PointInView(&numbers);
    std::vector<Bearing> bearings;
    bool seen = true;
    for (int i = 0; i < 4; ++i) {
      const Eigen::Vector3d p = point + poses[i].translation;
      seen = seen && std::atan2(std::hypot(p.x(), p.y()), p.z()) < 1.66;
      if (seen) bearings.push_back(See(camera, i == 3 ? PointInView(&numbers) : p));
    }
    if (!seen) continue;
    std::vector<PosedBearing> observations;
    observations.reserve(4);
    for (int i = 0; i < 4; ++i) observations.push_back({&bearings[i], &poses[i]});
    const TriangulatedPoint found = Triangulate(observations, {});
    if (found.num_kept == 0) continue;  // seen along the baseline: no angle
    EXPECT_EQ(found.num_kept, 3);
    EXPECT_FALSE(found.kept[3]);
    EXPECT_LT((found.point - point).norm(), kExact * point.norm());
    ++checked;
  }
  EXPECT_GE(checked, 60);
}

// Disturbs a bundle of exact data and expects adjustment to find the truth again.
void ExpectFoundAgain(const Bundle& exact, const Bundle& truth, bool through_lens) {
  Bundle bundle = exact;
  Disturb(&bundle, 11);
  BundleOptions options;
  options.gauge_image = 0;
  options.through_lens = through_lens;
  options.image_fixed = {1, 1, 0, 0, 0};  // the scale too
  bundle.camera_from_world[1] = truth.camera_from_world[1];
  options.function_tolerance = 1e-14;
  const BundleSummary summary = AdjustBundle(&bundle, options);
  EXPECT_GT(LengthOf(summary.cost_before, bundle), 1.0);
  EXPECT_LT(LengthOf(summary.cost_after, bundle), kExact);
  for (int i = 0; i < 5; ++i) {
    EXPECT_LT((bundle.camera_from_world[i].Matrix() - truth.camera_from_world[i].Matrix()).norm(),
              kExact);
  }
}

TEST(AdjustBundle, FindsExactDataAgainInBothResiduals) {
  const Bundle truth = MakeBundle(WideLens(), 5, 150, 10);
  ExpectFoundAgain(truth, truth, false);
  ExpectFoundAgain(truth, truth, true);
}

// Half of the pixels lie a period away from where the lens puts them, as at a panorama's seam.
TEST(AdjustBundle, MeasuresAPanoramaTheShortWayRoundItsSeam) {
  const Bundle truth = MakeBundle(Camera("equirectangular", {}, 1000, 500), 5, 150, 10);
  Bundle shifted = truth;
  for (std::size_t i = 0; i < shifted.observations.size(); i += 2) {
    shifted.observations[i].pixel.x() += i % 4 == 0 ? 1000.0 : -1000.0;
  }
  ExpectFoundAgain(shifted, truth, true);
}

// Images at a few places, which see all points, or those alone whose number is near their own.
TEST(AdjustBundle, SolvesManyImagesAsABandIfOnlyNeighboursShareTheirPoints) {
  constexpr int kPlaces = 5, kImages = 160, kPointsAnImage = 2, kWindow = 8;
  for (const bool shared : {false, true}) {
    Bundle bundle = MakeBundle(WideLens(), kPlaces, kImages * kPointsAnImage, 14);
    bundle.camera_of_image.assign(kImages, 0);
    for (int i = kPlaces; i < kImages; ++i) {
      bundle.camera_from_world.push_back(bundle.camera_from_world[i % kPlaces]);
    }
    ObserveAll(&bundle);
    if (!shared) {
      std::erase_if(bundle.observations, [](const BundleObservation& observation) {
        return std::abs(observation.image - observation.point / kPointsAnImage) > kWindow;
      });
    }
    BundleOptions options;
    options.image_fixed.assign(kImages, 0);
    options.image_fixed[0] = options.image_fixed[1] = 1;
    options.function_tolerance = 1e-14;
    const Pose second = bundle.camera_from_world[1];
    Disturb(&bundle, 15);
    bundle.camera_from_world[1] = second;
    const BundleSummary summary = AdjustBundle(&bundle, options);
    EXPECT_EQ(summary.fill == 1.0, shared);
    if (!shared) {
      EXPECT_LT(summary.fill, 0.35);  // worst 0.331
    }
    EXPECT_GT(LengthOf(summary.cost_before, bundle), 1.0);
    EXPECT_LT(LengthOf(summary.cost_after, bundle), kExact);
  }
}

TEST(AdjustBundle, ScaleImageKeepsItsHeldComponent) {
  const Bundle truth = MakeBundle(WideLens(), 5, 150, 14);
  Bundle bundle = truth;
  Disturb(&bundle, 15);
  const Eigen::Vector3d before = bundle.camera_from_world[4].CenterInSource();
  int axis = 0;
  before.cwiseAbs().maxCoeff(&axis);
  BundleOptions options;
  options.gauge_image = 0;
  options.scale_image = 4;
  AdjustBundle(&bundle, options);
  EXPECT_NEAR(bundle.camera_from_world[4].CenterInSource()[axis], before[axis], 1e-12);
  EXPECT_TRUE(bundle.camera_from_world[0].Matrix().isApprox(truth.camera_from_world[0].Matrix()));
}

TEST(PoseCovariances, PredictTheSpreadOfEstimates) {
  const Bundle truth = MakeBundle(WideLens(), 4, 60, 17);
  BundleOptions options;
  options.image_fixed = {1, 1, 0, 0};
  options.loss_scale = 0.0;
  constexpr double kNoise = 0.5;  // pixels
  constexpr int kRuns = 200;
  Eigen::Matrix<double, 6, 6> spread = Eigen::Matrix<double, 6, 6>::Zero();
  Eigen::Matrix<double, 6, 6> predicted = spread;
  Numbers numbers(18);
  for (int run = 0; run < kRuns; ++run) {
    Bundle bundle = truth;
    for (BundleObservation& o : bundle.observations) {
      o.pixel += kNoise * Eigen::Vector2d(numbers.Normal(), numbers.Normal());
      std::vector<std::uint8_t> has_ray;
      o.bearing = MakeBearings(bundle.cameras[0], std::span(&o.pixel, 1), &has_ray)[0];
    }
    AdjustBundle(&bundle, options);
    const Pose& found = bundle.camera_from_world[3];
    const Eigen::AngleAxisd turn(found.rotation * truth.camera_from_world[3].rotation.transpose());
    Eigen::Matrix<double, 6, 1> error;
    error << found.CenterInSource() - truth.camera_from_world[3].CenterInSource(),
        turn.angle() * turn.axis();
    spread += error * error.transpose() / kRuns;
    predicted += PoseCovariances(bundle, options)[3] / kRuns;
  }
  for (int k = 0; k < 6; ++k) {
    // A variance from 200 runs is known to 10 %; worst 22 %
    EXPECT_NEAR(spread(k, k) / predicted(k, k), 1.0, 0.35) << k;
  }
}

TEST(PoseCovariances, UndeterminedScaleIsAnError) {
  const Bundle bundle = MakeBundle(WideLens(), 4, 60, 19);
  BundleOptions options;  // no gauge at all, and an image that sees nothing
  options.gauge_image = 0;
  Bundle lonely = bundle;
  lonely.camera_from_world.emplace_back();
  lonely.camera_of_image.push_back(0);
  EXPECT_THROW(PoseCovariances(lonely, options), SolveError);
}

TEST(BuildTracks, NeverHoldTwoFeaturesOfOneImage) {
  const std::vector<int> counts = {3, 3, 3};
  std::vector<VerifiedPair> pairs(3);
  pairs[0] = {0, 1, {{0, 0}, {1, 1}, {2, 2}}, Pose(), 0, 0.0};
  pairs[1] = {1, 2, {{0, 0}, {1, 1}}, Pose(), 0, 0.0};
  pairs[2] = {0, 2, {{0, 1}}, Pose(), 0, 0.0};  // would join the first two tracks
  const auto tracks = BuildTracks(counts, pairs);
  ASSERT_EQ(tracks.size(), 3U);
  for (const auto& track : tracks) {
    std::set<int> images;
    for (const TrackElement& element : track) EXPECT_TRUE(images.insert(element.image).second);
  }
  pairs[2].matches[0] = {3, 0};
  EXPECT_THROW(BuildTracks(counts, pairs), InputError);
}

#ifdef GOOGLE_STRIP_LOG  // the logger is glog
TEST(QuietSolver, KeepsWarningsFromStandardErrorWhileItLives) {
  const auto logged = [] {
    testing::internal::CaptureStderr();
    LOG(WARNING) << "a step failed";
    return !testing::internal::GetCapturedStderr().empty();
  };
  EXPECT_TRUE(logged());
  {
    const QuietSolver quiet;
    EXPECT_FALSE(logged());
  }
  EXPECT_TRUE(logged());
}
#endif

TEST(MatchDescriptors, AgreesWithExhaustiveSearchOnEveryInstructionSet) {
  Numbers numbers(20);
  // As root-SIFT has them: of about the same length, and some bytes above 127.
  const auto byte = [](double value) {
    return static_cast<std::uint8_t>(std::clamp(std::round(value), 0.0, 255.0));
  };
  const auto make = [&](int count) {
    std::vector<std::uint8_t> set(static_cast<std::size_t>(count) * kDescriptorLength);
    for (std::uint8_t& value : set) value = byte(45.0 * std::abs(numbers.Normal()));
    return set;
  };
  std::vector<std::uint8_t> first = make(301), second = make(277);
  // A third of the first set stands in the second again, slightly changed and turned around.
  for (int i = 0; i < 100; ++i) {
    for (int k = 0; k < kDescriptorLength; ++k) {
      second[(276 - i) * kDescriptorLength + k] =
          byte(first[3 * i * kDescriptorLength + k] + 9.0 * numbers.Normal());
    }
  }
  std::fill_n(&second[5 * kDescriptorLength], kDescriptorLength, 0);    // it has no direction
  std::fill_n(&second[6 * kDescriptorLength], kDescriptorLength, 255);  // the largest sum
  Eigen::MatrixXd cosines(301, 277);
  const auto row_of = [](const std::vector<std::uint8_t>& set, int row) {
    Eigen::VectorXd values(kDescriptorLength);
    for (int k = 0; k < kDescriptorLength; ++k) values[k] = set[row * kDescriptorLength + k];
    return Eigen::VectorXd(values / std::max(values.norm(), 1e-12));
  };
  for (int i = 0; i < 301; ++i) {
    for (int j = 0; j < 277; ++j) cosines(i, j) = row_of(first, i).dot(row_of(second, j));
  }
  std::set<std::pair<int, int>> expected;
  for (int i = 0; i < 301; ++i) {
    int j = 0, back = 0;
    cosines.row(i).maxCoeff(&j);
    cosines.col(j).maxCoeff(&back);
    const double near = 2.0 - 2.0 * cosines(i, j);
    double next = 4.0;
    for (int k = 0; k < 277; ++k) {
      if (k != j) next = std::min(next, 2.0 - 2.0 * cosines(i, k));
    }
    for (int k = 0; k < 301; ++k) {
      if (k != i) next = std::min(next, 2.0 - 2.0 * cosines(k, j));
    }
    if (back == i && near <= 0.64 * next && near <= 0.49) expected.insert({i, j});
  }
  EXPECT_GE(expected.size(), 95U);
  std::set<std::string> kernels;
  std::vector<FeatureMatch> same;
  std::vector<std::string> isas = AvailableIsas();
  isas.emplace_back();  // nothing forced: dot products of bytes, where the processor has them
  for (const std::string& isa : isas) {
    SetIsa(isa);
    kernels.insert(MatchKernel());
    const auto matches = MatchDescriptors(first.data(), 301, second.data(), 277, {});
    std::set<std::pair<int, int>> found;
    for (const FeatureMatch& match : matches) found.insert({match.first, match.second});
    EXPECT_EQ(found, expected) << isa;
    if (same.empty()) same = matches;
    ASSERT_EQ(matches.size(), same.size());
    for (std::size_t i = 0; i < same.size(); ++i) {
      EXPECT_EQ(matches[i].first, same[i].first);
      EXPECT_EQ(matches[i].ratio, same[i].ratio) << MatchKernel();
      EXPECT_EQ(matches[i].distance, same[i].distance) << MatchKernel();
    }
  }
  SetIsa("");
  EXPECT_GE(kernels.size(), 2U);
  const bool has_byte_products = (hwy::SupportedTargets() & HWY_AVX3_DL) != 0;
  EXPECT_EQ(kernels.count("AVX3_DL"), has_byte_products ? 1U : 0U);
  EXPECT_TRUE(MatchDescriptors(first.data(), 0, second.data(), 277, {}).empty());
  EXPECT_TRUE(MatchDescriptors(first.data(), 301, second.data(), 0, {}).empty());
}

}  // namespace
}  // namespace gsut
