// Bundle adjustment against Ceres, which differentiates formulas of its own by itself.
#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <vector>

#include "gsut/sfm/bundle.h"
#include "synthetic_bundle.h"

namespace gsut {
namespace {

constexpr double kLoss = 1.0;    // pixels
constexpr double kSigma = 0.02;  // of each component of a velocity
constexpr double kNoise = 0.4;   // pixels a coordinate
// Relative; worst 2.3e-10, with clang and SSE4, else 2.9e-11: a step of 1e-8 ends the solver, and
// in a flat valley rounding decides where one is that small.
constexpr double kSameCost = 4.6e-10;
constexpr double kSamePlace = 4e-7;   // of scenes a few units large; worst 2.1e-7
constexpr double kSameParams = 2e-6;  // relative, of the lens; worst 9.5e-7

using Six = std::array<double, 6>;

// (rotation vector of camera_from_world, centre).
Six ToSix(const Pose& pose) {
  const Eigen::AngleAxisd turn(pose.rotation);
  Six six;
  Eigen::Map<Eigen::Vector3d>(six.data()) = turn.angle() * turn.axis();
  Eigen::Map<Eigen::Vector3d>(six.data() + 3) = pose.CenterInSource();
  return six;
}

template <typename T>
void Carry(const T* six, const T* point, T* out) {
  const T shifted[3] = {point[0] - six[3], point[1] - six[4], point[2] - six[5]};
  ceres::AngleAxisRotatePoint(six, shifted, out);
}

// Kannala and Brandt's lens, 2006, as OpenCV orders its parameters.
struct PixelError {
  template <typename T>
  bool operator()(const T* body, const T* velocity, const T* mount, const T* point, const T* lens,
                  T* error) const {
    T earlier[3], turn[3], in_middle[3], on_body[3], p[3];
    for (int k = 0; k < 3; ++k) {
      earlier[k] = point[k] - time * velocity[k];
      turn[k] = time * velocity[3 + k];
    }
    Carry(body, earlier, in_middle);
    ceres::AngleAxisRotatePoint(turn, in_middle, on_body);
    Carry(mount, on_body, p);
    const T radius = ceres::sqrt(p[0] * p[0] + p[1] * p[1]);
    const T angle = ceres::atan2(radius, p[2]), square = angle * angle;
    const T image =
        angle *
        (1.0 + square * (lens[4] + square * (lens[5] + square * (lens[6] + square * lens[7]))));
    error[0] = lens[0] * image * p[0] / radius + lens[2] - pixel.x();
    error[1] = lens[1] * image * p[1] / radius + lens[3] - pixel.y();
    return true;
  }
  Eigen::Vector2d pixel;
  double time;
};

struct PriorError {
  template <typename T>
  bool operator()(const T* velocity, T* error) const {
    for (int k = 0; k < 6; ++k) error[k] = kNoise / kSigma * velocity[k];
    return true;
  }
};

// The same unknowns in Ceres' hands. What an image's camera is not mounted on stands at the origin.
class CeresBundle {
 public:
  CeresBundle(const Bundle& bundle, const BundleOptions& options)
      : bundle_(bundle), loss_(kLoss), lens_(bundle.cameras[0].params()), points_(bundle.points) {
    for (const Pose& pose : bundle.camera_from_world) bodies_.push_back(ToSix(pose));
    for (const Pose& pose : bundle.camera_from_body) mount_ = ToSix(pose);
    velocities_.resize(bodies_.size(), Six{});
    for (std::size_t i = 0; i < bundle.velocities.size(); ++i) {
      Eigen::Map<Velocity>(velocities_[i].data()) = bundle.velocities[i];
    }
    ceres::Problem::Options settings;
    settings.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    problem_ = std::make_unique<ceres::Problem>(settings);
    for (const BundleObservation& o : bundle.observations) AddObservation(o);
    AddPriors(options);
    Hold(options);
  }

  // Half of the robust squares, as Ceres counts them.
  double Cost() {
    double cost = 0.0;
    problem_->Evaluate({}, &cost, nullptr, nullptr, nullptr);
    return cost;
  }

  void Solve() {
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_SCHUR;
    options.max_num_iterations = 200;
    options.function_tolerance = options.parameter_tolerance = options.gradient_tolerance = 1e-16;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, problem_.get(), &summary);
    ASSERT_TRUE(summary.IsSolutionUsable()) << summary.message;
  }

  double CenterDistance(const CeresBundle& other) const {
    double most = 0.0;
    for (std::size_t i = 0; i < bodies_.size(); ++i) {
      if (BodyOf(static_cast<int>(i)) != static_cast<int>(i)) continue;
      most = std::max(most, (Center(bodies_[i]) - Center(other.bodies_[i])).norm());
    }
    return std::max(most, (Center(mount_) - Center(other.mount_)).norm());
  }

  double LensDistance(const CeresBundle& other) const {
    double most = 0.0;
    for (std::size_t k = 0; k < lens_.size(); ++k) {
      most = std::max(most, std::abs(lens_[k] - other.lens_[k]) / std::abs(lens_[k]));
    }
    return most;
  }

 private:
  static Eigen::Vector3d Center(const Six& six) { return {six[3], six[4], six[5]}; }
  int BodyOf(int image) const {
    return bundle_.body_of_image.empty() ? image : 2 * bundle_.body_of_image[image];
  }

  void AddObservation(const BundleObservation& o) {
    const bool mounted = !bundle_.mount_of_image.empty() && bundle_.mount_of_image[o.image] >= 0;
    auto* cost = new ceres::AutoDiffCostFunction<PixelError, 2, 6, 6, 6, 3, 8>(
        new PixelError{o.pixel, o.time});
    problem_->AddResidualBlock(
        cost, &loss_, bodies_[BodyOf(o.image)].data(), velocities_[BodyOf(o.image)].data(),
        mounted ? mount_.data() : none_.data(), points_[o.point].data(), lens_.data());
  }

  void AddPriors(const BundleOptions& options) {
    for (std::size_t i = 0; i < bodies_.size(); ++i) {
      if (!problem_->HasParameterBlock(bodies_[i].data())) continue;
      if (options.velocity_priors.empty()) {
        problem_->SetParameterBlockConstant(velocities_[i].data());
      } else if (!options.image_fixed[i]) {
        problem_->AddResidualBlock(
            new ceres::AutoDiffCostFunction<PriorError, 6, 6>(new PriorError), nullptr,
            velocities_[i].data());
      }
    }
  }

  void Hold(const BundleOptions& options) {
    for (std::size_t i = 0; i < options.image_fixed.size(); ++i) {
      if (!options.image_fixed[i] || BodyOf(static_cast<int>(i)) != static_cast<int>(i)) continue;
      problem_->SetParameterBlockConstant(bodies_[i].data());
      problem_->SetParameterBlockConstant(velocities_[i].data());
    }
    if (problem_->HasParameterBlock(none_.data()))
      problem_->SetParameterBlockConstant(none_.data());
    if (options.lens_free.empty()) {
      problem_->SetParameterBlockConstant(lens_.data());
    } else {
      problem_->SetManifold(lens_.data(), new ceres::SubsetManifold(8, {6, 7}));
    }
  }

  const Bundle& bundle_;
  ceres::CauchyLoss loss_;
  std::vector<Six> bodies_, velocities_;
  Six mount_{}, none_{};
  std::vector<double> lens_;
  std::vector<Eigen::Vector3d> points_;
  std::unique_ptr<ceres::Problem> problem_;
};

// Noise, and every twentieth match wrong by several pixels.
void AddNoise(Bundle* bundle, std::uint64_t stream) {
  Numbers numbers(stream);
  for (std::size_t i = 0; i < bundle->observations.size(); ++i) {
    const double size = i % 20 == 7 ? 10 * kNoise : kNoise;
    bundle->observations[i].pixel += size * Eigen::Vector2d(numbers.Normal(), numbers.Normal());
  }
}

void ExpectSameMinimum(const Bundle& start, BundleOptions options) {
  options.through_lens = true;
  options.loss_scale = kLoss;
  options.noise = kNoise;
  options.function_tolerance = 1e-16;
  options.max_iterations = 200;
  Bundle found = start;
  AdjustBundle(&found, options);
  CeresBundle before(start, options), own(found, options), theirs(start, options);
  theirs.Solve();
  EXPECT_GT(before.Cost(), 2.0 * theirs.Cost());
  EXPECT_LT(own.Cost() / theirs.Cost() - 1.0, kSameCost);
  EXPECT_LT(own.CenterDistance(theirs), kSamePlace);
  EXPECT_LT(own.LensDistance(theirs), kSameParams);
  EXPECT_GT(own.CenterDistance(before), 1e3 * kSamePlace);
}

TEST(AdjustBundle, FindsTheMinimumOfCeresWithARollingShutterAndAFreeLens) {
  Bundle bundle = MakeBundle(WideLens(), 6, 120, 81);
  Numbers numbers(82);
  for (int i = 0; i < 6; ++i) {
    Velocity velocity;
    velocity << 0.02 * numbers.Vector(), 0.02 * numbers.Vector();
    bundle.velocities.push_back(velocity);
  }
  ObserveAll(&bundle);
  AddNoise(&bundle, 83);
  const Pose second = bundle.camera_from_world[1];
  Disturb(&bundle, 84);
  bundle.camera_from_world[1] = second;
  std::vector<double> params = bundle.cameras[0].params();
  params[0] *= 1.01;
  params[2] += 2.0;
  bundle.cameras[0] = Camera("kannala_brandt", params, 1000, 1010);
  BundleOptions options;
  options.image_fixed = {1, 1, 0, 0, 0, 0};
  options.lens_free = {{1, 1, 1, 1, 1, 1, 0, 0}};
  VelocityPrior prior;
  prior.sigma.setConstant(kSigma);
  options.velocity_priors.assign(6, prior);
  ExpectSameMinimum(bundle, options);
}

TEST(AdjustBundle, FindsTheMinimumOfCeresOnARig) {
  Bundle bundle = RigBundle(120, 85);
  AddNoise(&bundle, 86);
  const Pose third = bundle.camera_from_world[2];
  Disturb(&bundle, 87);
  bundle.camera_from_world[2] = third;
  BundleOptions options;
  options.image_fixed = {1, 1, 1, 1, 0, 0, 0, 0};
  options.mount_free = {1};
  ExpectSameMinimum(bundle, options);
}

}  // namespace
}  // namespace gsut
