// Blocks of unknowns, and what observations say of them.
#include "gsut/sfm/bundle_problem.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "gsut/base/parallel.h"
#include "gsut/geometry/rotation_vector.h"
#include "gsut/sfm/lens_parameters.h"

namespace gsut {
namespace {

constexpr std::int64_t kResidualGrain = 256;  // observations a chunk of parallel work
constexpr double kSmallStep = 1e-8;  // share of the unknowns' length below which a step is none

using RowMajor2X = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;

// log(1 + x) at a third of the time of std::log1p: the error of u cancels (Goldberg, "What every
// computer scientist should know about floating-point arithmetic", 1991, theorem 4).
double LogOfOnePlus(double x) {
  const double u = 1.0 + x;
  return u == 1.0 ? x : std::log(u) * (x / (u - 1.0));
}

bool Flag(const std::vector<std::uint8_t>& flags, int index) {
  return !flags.empty() && flags[index] != 0;
}

}  // namespace

BundleProblem::BundleProblem(const Bundle& bundle, const BundleOptions& options)
    : bundle_(bundle),
      options_(options),
      state_(bundle),
      gauge_body_(BodyOf(options.gauge_image)),
      scale_body_(gauge_body_ < 0 ? -1 : BodyOf(options.scale_image)),
      used_body_(state_.num_bodies()),
      fixed_body_(state_.num_bodies()),
      used_lens_(state_.lenses.size()),
      used_mount_(state_.mounts.size()) {
  if (options.through_lens) {
    evaluation_ = std::make_unique<LensEvaluation>(bundle, state_, options.lens_free);
  }
  for (const BundleObservation& observation : bundle.observations) {
    used_body_[BodyOf(observation.image)] = 1;
    const int mount = state_.mount_of_image[observation.image];
    if (mount >= 0) used_mount_[mount] = 1;
    used_lens_[bundle.camera_of_image[observation.image]] = 1;
  }
  for (std::size_t image = 0; image < options_.image_fixed.size(); ++image) {
    if (options_.image_fixed[image]) fixed_body_[BodyOf(static_cast<int>(image))] = 1;
  }
  state_.calibration.setZero(options.calibration_sigma.size());
  MakeBlocks();
  MakeSystem();
}

// Blocks of the reduced system, bodies first, in the order of images: for a walk that is a band.
// Mounts and lenses come last, since nearly all bodies see them.
void BundleProblem::MakeBlocks() {
  const auto add = [&](int unknowns) {
    sizes_.push_back(unknowns);
    return static_cast<int>(sizes_.size()) - 1;
  };
  body_block_.assign(state_.num_bodies(), -1);
  for (int body = 0; body < state_.num_bodies(); ++body) {
    if (!used_body_[body] || fixed_body_[body]) continue;
    const bool moves =
        !state_.velocities.empty() && !Flag(options_.velocity_fixed, state_.image_of_body[body]);
    body_block_[body] = add(moves ? 2 * kPoseTangent : kPoseTangent);
  }
  num_bodies_ = static_cast<int>(sizes_.size());
  mount_block_.assign(state_.mounts.size(), -1);
  for (std::size_t m = 0; m < state_.mounts.size(); ++m) {
    if (used_mount_[m] && Flag(options_.mount_free, static_cast<int>(m))) {
      mount_block_[m] = add(kPoseTangent);
    }
  }
  lens_block_.assign(state_.lenses.size(), -1);
  lens_columns_.resize(state_.lenses.size());
  free_columns_.resize(state_.lenses.size());
  lens_params_.resize(state_.lenses.size());
  for (std::size_t c = 0; c < options_.lens_free.size(); ++c) {
    lens_columns_[c] = FreeLensColumns(options_.lens_free[c]);
    free_columns_[c] = lens_columns_[c](FreeLensParams(options_.lens_free[c]), Eigen::all);
    if (used_lens_[c] && lens_columns_[c].cols() > 0) {
      lens_block_[c] = add(static_cast<int>(lens_columns_[c].cols()));
    }
    for (int k = 0; k < lens_columns_[c].cols(); ++k) {
      Eigen::Index first = 0;
      lens_columns_[c].col(k).maxCoeff(&first);
      lens_params_[c].push_back(static_cast<int>(first));
    }
  }
  if (!options_.turn_priors.empty() && state_.calibration.size() > 0) {
    calibration_block_ = add(static_cast<int>(state_.calibration.size()));
  }
}

void BundleProblem::MakeSystem() {
  std::vector<ReducedSystem::Dependence> observations;
  observations.reserve(bundle_.observations.size());
  for (const BundleObservation& observation : bundle_.observations) {
    const int mount = state_.mount_of_image[observation.image];
    ReducedSystem::Dependence& own = observations.emplace_back();
    own.point = Flag(options_.point_fixed, observation.point) ? -1 : observation.point;
    for (const int block :
         {body_block_[BodyOf(observation.image)], mount < 0 ? -1 : mount_block_[mount],
          lens_block_[bundle_.camera_of_image[observation.image]]}) {
      if (block >= 0) own.blocks[own.num_blocks++] = block;
    }
  }
  const int num_points = static_cast<int>(state_.points.size()) + AppendTurns(&observations);
  AppendPointPriors(&observations);
  system_ = std::make_unique<ReducedSystem>(sizes_, num_bodies_, num_points, observations);
  if (calibration_block_ >= 0) {
    system_->PriorWeights(calibration_block_) =
        options_.noise * options_.calibration_sigma.cwiseInverse();
  }
  // The gauge: seven degrees of freedom change no picture. Six are the pose of the gauge's body,
  // the seventh, the scale, is one coordinate of another centre.
  for (int body = 0; body < state_.num_bodies(); ++body) {
    const int block = body_block_[body];
    if (block < 0) continue;
    if (body == gauge_body_) {
      std::fill_n(system_->Held(block).begin(), kPoseTangent, 1);
    } else if (body == scale_body_) {
      system_->Held(block)[ScaleAxis(state_.poses[gauge_body_], state_.poses[body])] = 1;
    }
    if (system_->iterative()) system_->Motions(block) = SimilarityMotions(body, block);
    if (!options_.place_priors.empty()) {
      const PlacePrior& place = options_.place_priors[state_.image_of_body[body]];
      system_->PriorWeights(block).head<3>() = options_.noise * place.sigma.cwiseInverse();
    }
    if (!Moves(block) || options_.velocity_priors.empty()) continue;
    const VelocityPrior& prior = options_.velocity_priors[state_.image_of_body[body]];
    system_->PriorWeights(block).tail<6>() = options_.noise * prior.sigma.cwiseInverse();
  }
  for (std::size_t m = 0; m < state_.mounts.size() && !options_.mount_priors.empty(); ++m) {
    if (mount_block_[m] < 0) continue;
    auto& weights = system_->PriorWeights(mount_block_[m]);
    weights.head<3>().setConstant(options_.noise / options_.mount_center_sigma);
    weights.tail<3>().setConstant(options_.noise / options_.mount_turn_sigma);
  }
  for (std::size_t c = 0; c < state_.lenses.size(); ++c) {
    if (!HasPrior(c)) continue;
    for (std::size_t k = 0; k < lens_params_[c].size(); ++k) {
      system_->PriorWeights(lens_block_[c])[static_cast<Eigen::Index>(k)] =
          options_.noise / options_.lens_priors[c].sigma[lens_params_[c][k]];
    }
  }
}

// How a body's block changes when the whole scene is shifted, turned and scaled: no picture does.
Eigen::MatrixXd BundleProblem::SimilarityMotions(int body, int block) const {
  const double* pose = state_.poses[body].data();
  Eigen::MatrixXd motions = Eigen::MatrixXd::Zero(sizes_[block], 7);
  motions.topLeftCorner<3, 3>().setIdentity();
  motions.block<3, 3>(0, 3) = -Skew(CenterOf(pose));
  motions.block<3, 3>(3, 3) = -RotationOf(pose);
  motions.block<3, 1>(0, 6) = CenterOf(pose);
  if (Moves(block)) {
    const Eigen::Vector3d shift = state_.velocities[body].head<3>();
    motions.block<3, 3>(6, 3) = -Skew(shift);
    motions.block<3, 1>(6, 6) = shift;
  }
  for (int k = 0; k < sizes_[block]; ++k) {
    if (system_->Held(block)[k]) motions.row(k).setZero();
  }
  return motions;
}

// Partial sums of chunks are added in order: the cost has the same bits on any number of threads.
double BundleProblem::Evaluate() {
  if (evaluation_) evaluation_->Evaluate();
  const auto count = static_cast<std::int64_t>(bundle_.observations.size());
  double cost = ParallelSum(count, kResidualGrain, [&](std::int64_t begin, std::int64_t end) {
    double sum = 0.0;
    for (std::int64_t i = begin; i < end; ++i) sum += Linearize(static_cast<int>(i));
    return sum;
  });
  return cost + EvaluatePriors();
}

double BundleProblem::EvaluatePriors() {
  double cost = 0.0;
  for (int body = 0; body < state_.num_bodies() && !options_.place_priors.empty(); ++body) {
    const int block = body_block_[body];
    if (block < 0) continue;
    const PlacePrior& prior = options_.place_priors[state_.image_of_body[body]];
    auto residuals = system_->PriorResiduals(block).head<3>();
    residuals = system_->PriorWeights(block).head<3>().cwiseProduct(
        CenterOf(state_.poses[body].data()) - prior.mean);
    cost += 0.5 * residuals.squaredNorm();
  }
  for (int body = 0; body < state_.num_bodies() && !options_.velocity_priors.empty(); ++body) {
    const int block = body_block_[body];
    if (block < 0 || !Moves(block)) continue;
    const VelocityPrior& prior = options_.velocity_priors[state_.image_of_body[body]];
    auto residuals = system_->PriorResiduals(block).tail<6>();
    residuals =
        system_->PriorWeights(block).tail<6>().cwiseProduct(state_.velocities[body] - prior.mean);
    cost += 0.5 * residuals.squaredNorm();
  }
  for (std::size_t m = 0; m < state_.mounts.size() && !options_.mount_priors.empty(); ++m) {
    const int block = mount_block_[m];
    if (block < 0) continue;
    const Pose& prior = options_.mount_priors[m];
    const double* mount = state_.mounts[m].data();
    // The turn between both changes as the mount's own: their difference is small.
    Velocity change;
    change << CenterOf(mount) - prior.CenterInSource(),
        VectorOfRotation(RotationOf(mount) * prior.rotation.transpose());
    system_->PriorResiduals(block) = system_->PriorWeights(block).cwiseProduct(change);
    cost += 0.5 * system_->PriorResiduals(block).squaredNorm();
  }
  return cost + EvaluateLensPriors() + EvaluateTurns() + EvaluatePointPriors();
}

double BundleProblem::EvaluateLensPriors() {
  double cost = 0.0;
  for (std::size_t c = 0; c < state_.lenses.size(); ++c) {
    if (!HasPrior(c)) continue;
    Eigen::VectorXd& residuals = system_->PriorResiduals(lens_block_[c]);
    for (std::size_t k = 0; k < lens_params_[c].size(); ++k) {
      const int param = lens_params_[c][k];
      const auto column = static_cast<Eigen::Index>(k);
      // By the column's own amount: without what the columns before it change.
      residuals[column] = state_.lenses[c][param] - options_.lens_priors[c].mean[param] -
                          lens_columns_[c].row(param).head(column).dot(residuals.head(column));
    }
    residuals.array() *= system_->PriorWeights(lens_block_[c]).array();
    cost += 0.5 * residuals.squaredNorm();
  }
  return cost;
}

double BundleProblem::Linearize(int i) {
  const BundleObservation& observation = bundle_.observations[i];
  ObservationResidual found;
  if (!EvaluateObservation(bundle_, state_, i, evaluation_.get(), &found)) {
    return std::numeric_limits<double>::infinity();
  }
  const double squared = found.residual.squaredNorm() / (observation.noise * observation.noise);
  // rho(s) = b log(1 + s / b), rho' = 1 / (1 + s / b), with s the squared residual, b the squared
  // scale: Gauss-Newton sees residuals times sqrt(rho'), and the cost is rho / 2.
  // Cauchy's loss, by weights.
  double cost = squared, weight = 1.0;
  if (options_.loss_scale > 0) {
    const double bend = options_.loss_scale * options_.loss_scale;
    cost = bend * LogOfOnePlus(squared / bend);
    weight = std::sqrt(1.0 / (1.0 + squared / bend));
  }
  weight /= observation.noise;
  system_->Residual(i) = weight * found.residual;
  system_->ByPoint(i) = weight * found.by.by_point;
  double* out = system_->ByBlocks(i);
  const auto write = [&](const auto& derivatives, int size, int at, int columns) {
    Eigen::Map<RowMajor2X, 0, Eigen::OuterStride<>>(
        out + at, 2, columns, Eigen::OuterStride<>(size)) = weight * derivatives;
  };
  const int body = BodyOf(observation.image), mount = state_.mount_of_image[observation.image];
  if (const int block = body_block_[body]; block >= 0) {
    const int size = sizes_[block];
    write(found.by.by_pose, size, 0, kPoseTangent);
    if (Moves(block)) write(found.by.by_velocity, size, kPoseTangent, kPoseTangent);
    // Held components have no derivatives: their row and column of the system are zero.
    if (body == gauge_body_ || body == scale_body_) {
      for (int k = 0; k < size; ++k) {
        if (system_->Held(block)[k]) out[k] = out[size + k] = 0.0;
      }
    }
    out += 2 * size;
  }
  if (mount >= 0 && mount_block_[mount] >= 0) {
    write(found.by.by_mount, kPoseTangent, 0, kPoseTangent);
    out += 2 * kPoseTangent;
  }
  const int camera = bundle_.camera_of_image[observation.image];
  if (lens_block_[camera] >= 0) {
    const auto& columns = free_columns_[camera];
    const int size = static_cast<int>(columns.cols());
    Eigen::Map<RowMajor2X> by_lens(out, 2, size);
    by_lens.setZero();
    if (found.by_params != nullptr) {
      by_lens.noalias() +=
          weight * Eigen::Map<const RowMajor2X>(found.by_params, 2, columns.rows()) * columns;
    }
  }
  return 0.5 * cost;
}

// Compares the step's length with that of all unknowns, in units as they are: what is left to gain
// below kSmallStep is rounding.
bool BundleProblem::Step() {
  double length = 0.0, size = 0.0;
  const auto count = [&](double change, double value) {
    length += change;
    size += value;
  };
  for (int body = 0; body < state_.num_bodies(); ++body) {
    const int block = body_block_[body];
    if (block < 0) continue;
    const Eigen::VectorXd change = system_->BlockStep(block);
    AddToPose(change.head<kPoseTangent>(), &state_.poses[body]);
    if (Moves(block)) state_.velocities[body] += change.tail<kPoseTangent>();
    count(change.squaredNorm(), 1.0 + CenterOf(state_.poses[body].data()).squaredNorm());
  }
  for (std::size_t m = 0; m < state_.mounts.size(); ++m) {
    if (mount_block_[m] < 0) continue;
    const Eigen::VectorXd change = system_->BlockStep(mount_block_[m]);
    AddToPose(change, &state_.mounts[m]);
    count(change.squaredNorm(), 1.0 + CenterOf(state_.mounts[m].data()).squaredNorm());
  }
  for (std::size_t c = 0; c < state_.lenses.size(); ++c) {
    if (lens_block_[c] < 0) continue;
    Eigen::Map<Eigen::VectorXd> lens(state_.lenses[c].data(), lens_columns_[c].rows());
    const Eigen::VectorXd change = lens_columns_[c] * system_->BlockStep(lens_block_[c]);
    lens += change;
    count(change.squaredNorm(), lens.squaredNorm());
  }
  if (calibration_block_ >= 0) state_.calibration += system_->BlockStep(calibration_block_);
  for (std::size_t p = 0; p < state_.points.size(); ++p) {
    if (Flag(options_.point_fixed, static_cast<int>(p))) continue;
    const Eigen::Vector3d& change = system_->PointStep(static_cast<int>(p));
    state_.points[p] += change;
    count(change.squaredNorm(), state_.points[p].squaredNorm());
  }
  return std::sqrt(length) <= kSmallStep * (std::sqrt(size) + kSmallStep);
}

void BundleProblem::Store(Bundle* bundle) const {
  for (std::size_t i = 0; i < bundle->camera_from_world.size(); ++i) {
    const int image = static_cast<int>(i);
    const int body = BodyOf(image);
    if (!used_body_[body]) continue;
    if (!bundle->velocities.empty()) bundle->velocities[i] = state_.velocities[body];
    // A pose that stayed keeps its digits; other cameras of its body follow it.
    // Its block may have been normalised, which changes the last digit.
    const bool stays = (body == gauge_body_ || fixed_body_[body]) &&
                       state_.image_of_body[body] == image && state_.mount_of_image[image] < 0;
    if (!stays) bundle->camera_from_world[i] = state_.CameraFromWorld(image);
  }
  for (std::size_t m = 0; m < state_.mounts.size(); ++m) {
    if (mount_block_[m] >= 0) {
      bundle->camera_from_body[m] = FromBlock(state_.mounts[m]);
    }
  }
  bundle->points = state_.points;
  for (std::size_t c = 0; c < state_.lenses.size(); ++c) {
    if (lens_block_[c] < 0) continue;
    const Camera& camera = bundle->cameras[c];
    bundle->cameras[c] = Camera(camera.model(), state_.lenses[c], camera.width(), camera.height(),
                                camera.valid_field_angle());
  }
}

}  // namespace gsut
