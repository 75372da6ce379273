// Covariances of the poses of a bundle: the reduced normal equations, inverted.
#include <algorithm>
#include <cmath>
#include <utility>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/sfm/bundle.h"
#include "gsut/sfm/bundle_problem.h"
#include "gsut/sfm/bundle_state.h"
#include "gsut/sfm/dense.h"
#include "gsut/sfm/eliminate_points.h"
#include "gsut/geometry/rotation_vector.h"

namespace gsut {
namespace {

// At the minimum the covariance of all unknowns is sigma^2 (J^T J)^-1, and that of the poses alone
// is its block, which is sigma^2 times the inverse of what is left when points are eliminated. No
// damping here: what the gauge leaves free must be determined.

// Bodies beyond which their velocities count as known: memory grows with the square of the
// unknowns, time with the cube.
constexpr int kMostMoving = 400;
constexpr Eigen::Index kColumns = 60;          // of the inverse, made at once
constexpr std::int64_t kCovarianceGrain = 64;  // observations of a chunk of parallel work

using Matrix6 = Eigen::Matrix<double, 6, 6>;

// Pose and, if bodies move, velocity.
int UnknownsOfBody(const BundleState& state) {
  return state.velocities.empty() ? kPoseTangent : 2 * kPoseTangent;
}

// (centre, turn) of an image's camera by those of its body.
Matrix6 CameraByBody(const BundleState& state, int image) {
  // centre = body's centre + R_body^T c, c the camera's on the body: a turn w of the body moves it
  // by R_body^T (c x w); the camera's own turn is R_mount w.
  Matrix6 by = Matrix6::Identity();
  const int mount = state.mount_of_image[image];
  if (mount < 0) return by;
  const double* block = state.mounts[mount].data();
  const Eigen::Matrix3d world_from_body =
      RotationOf(state.poses[state.body_of_image[image]].data()).transpose();
  by.topRightCorner<3, 3>() = world_from_body * Skew(CenterOf(block));
  by.bottomRightCorner<3, 3>() = RotationOf(block);
  return by;
}

// At the current unknowns and weighted by the loss as in the normal equations of the last step;
// size: unknowns of a body; squares: sum of the weighted residuals'.
ObservationTable Linearize(const Bundle& bundle, const BundleState& state, double loss_scale,
                           int size, double* squares) {
  ObservationTable found;
  const auto count = static_cast<std::int64_t>(bundle.observations.size());
  found.linear.resize(count);
  found.of_point.resize(bundle.points.size());
  std::vector<double> weighted(count);
  ParallelFor(count, kCovarianceGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const BundleObservation& observation = bundle.observations[i];
      const CameraChain chain = state.Chain(observation);
      const Eigen::Vector3d& point = bundle.points[observation.point];
      Eigen::Matrix<double, 2, 3> by_p;
      const Eigen::Vector2d residual =
          BearingResidual(observation.bearing, chain.Point(point), &by_p);
      const double squared = residual.squaredNorm() / (observation.noise * observation.noise);
      const double by_loss =
          loss_scale > 0 ? std::sqrt(1.0 / (1.0 + squared / (loss_scale * loss_scale))) : 1.0;
      weighted[i] = by_loss * by_loss * squared;
      const double weight = by_loss / observation.noise;
      const ChainDerivatives by = Derivatives(chain, point, weight * by_p);
      ObservationDerivatives& linear = found.linear[i];
      linear.body = state.body_of_image[observation.image];
      linear.by_point = by.by_point;
      linear.by_body.resize(2, size);
      linear.by_body.leftCols<6>() = by.by_pose;
      if (size > kPoseTangent) linear.by_body.rightCols<6>() = by.by_velocity;
    }
  });
  // In order, for the same bits on any number of threads.
  for (std::int64_t i = 0; i < count; ++i) {
    *squares += weighted[i];
    found.of_point[bundle.observations[i].point].push_back(static_cast<int>(i));
  }
  return found;
}

// Adds what is known beforehand of the velocities.
void AddVelocityPriors(const BundleState& state, const BundleOptions& options, int size,
                       Eigen::MatrixXd* reduced) {
  for (std::size_t i = 0; i < options.velocity_priors.size(); ++i) {
    const int body = state.body_of_image[i];
    if (state.image_of_body[body] != static_cast<int>(i)) continue;
    const Velocity weight = options.noise * options.velocity_priors[i].sigma.cwiseInverse();
    reduced->diagonal().segment<6>(size * body + kPoseTangent) += weight.cwiseAbs2();
  }
}

// The unknowns of the bodies, `size` each, that the gauge leaves.
std::vector<int> FreeUnknowns(const BundleState& state, const BundleOptions& options, int size) {
  int held = -1, gauge_body = -1, scale_body = -1;
  if (options.gauge_image >= 0) gauge_body = state.body_of_image[options.gauge_image];
  if (gauge_body >= 0 && options.scale_image >= 0) {
    scale_body = state.body_of_image[options.scale_image];
    held = ScaleAxis(state.poses[gauge_body], state.poses[scale_body]);
  }
  // Velocities of the gauge's body remain unknown: it is held in the middle of its readout only.
  std::vector<std::uint8_t> fixed(state.num_bodies(), 0);
  for (std::size_t i = 0; i < options.image_fixed.size(); ++i) {
    if (options.image_fixed[i]) fixed[state.body_of_image[i]] = 1;
  }
  std::vector<int> free;
  for (int body = 0; body < state.num_bodies(); ++body) {
    if (fixed[body]) continue;
    for (int k = body == gauge_body ? kPoseTangent : 0; k < size; ++k) {
      if (!(body == scale_body && k == held)) free.push_back(size * body + k);
    }
  }
  return free;
}

// The rows and columns of a matrix that are kept, in its own memory: two of them may not fit.
Eigen::Map<Eigen::MatrixXd> KeepFree(const std::vector<int>& free, Eigen::MatrixXd* matrix) {
  const auto size = static_cast<Eigen::Index>(free.size());
  double* to = matrix->data();
  for (const int column : free) {
    for (const int row : free) *to++ = (*matrix)(row, column);
  }
  return {matrix->data(), size, size};
}

// The blocks of bodies on the diagonal of the inverse: with S = L L^T, S^-1 = L^-T L^-1, some
// columns of L^-1 at a time, which are zero above their own rows.
std::vector<Matrix6> InvertBlocks(Eigen::Ref<Eigen::MatrixXd> normal, const std::vector<int>& free,
                                  int bodies, int unknowns) {
  if (!FactorizeCholesky(normal)) {
    throw SolveError("an image, or the scale, is not determined by the points it sees");
  }
  std::vector<Matrix6> blocks(bodies, Matrix6::Zero());
  const Eigen::Index size = normal.rows();
  const auto body_of = [&](Eigen::Index i) { return free[i] / unknowns; };
  // Groups of columns end where a body does. Each group is independent of all others.
  std::vector<Eigen::Index> ends(1, 0);
  while (ends.back() < size) {
    Eigen::Index end = std::min(ends.back() + kColumns, size);
    while (end < size && body_of(end) == body_of(end - 1)) ++end;
    ends.push_back(end);
  }
  ParallelFor(static_cast<std::int64_t>(ends.size()) - 1, 1, [&](std::int64_t n, std::int64_t) {
    const Eigen::Index begin = ends[n], end = ends[n + 1];
    Eigen::MatrixXd columns = Eigen::MatrixXd::Identity(size - begin, end - begin);
    SolveLower(normal.bottomRightCorner(size - begin, size - begin), columns);
    const Eigen::MatrixXd found = MultiplyByTranspose(columns);
    for (Eigen::Index i = begin; i < end; ++i) {
      for (Eigen::Index j = begin; j < end; ++j) {
        const int row = free[i] % unknowns, column = free[j] % unknowns;
        if (body_of(i) != body_of(j) || std::max(row, column) >= kPoseTangent) continue;
        blocks[body_of(i)](row, column) = found(i - begin, j - begin);
      }
    }
  });
  return blocks;
}

}  // namespace

std::vector<Matrix6> PoseCovariances(const Bundle& bundle, const BundleOptions& options) {
  CheckObservations(bundle);
  const int images = static_cast<int>(bundle.camera_from_world.size());
  const BundleState state(bundle);
  const int bodies = state.num_bodies();
  const int size = bodies > kMostMoving ? kPoseTangent : UnknownsOfBody(state);
  double squares = 0.0;
  ObservationTable observations = Linearize(bundle, state, options.loss_scale, size, &squares);
  const std::vector<int> free = FreeUnknowns(state, options, size);
  // A direction in which a point is open, as along the ray of a single sight, says nothing and
  // takes no freedom.
  EliminatedPoints left = EliminatePoints(std::move(observations), bodies, size, 0);
  // Residuals less unknowns: what is left to estimate the noise from.
  const std::int64_t freedom = 2 * static_cast<std::int64_t>(bundle.observations.size()) -
                               left.determined - static_cast<std::int64_t>(free.size());
  const double variance = squares / static_cast<double>(std::max<std::int64_t>(1, freedom));
  if (size > kPoseTangent) AddVelocityPriors(state, options, size, &left.normal);
  const std::vector<Matrix6> of_body =
      InvertBlocks(KeepFree(free, &left.normal), free, bodies, size);
  std::vector<Matrix6> covariances(images);
  for (int image = 0; image < images; ++image) {
    const Matrix6 by_body = CameraByBody(state, image);
    covariances[image] =
        by_body * (variance * of_body[state.body_of_image[image]]) * by_body.transpose();
  }
  return covariances;
}

}  // namespace gsut
