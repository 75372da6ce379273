// What a gyroscope and a survey say of a bundle, as observations of the reduced system: turns
// between images, and places of points.
#include <cmath>

#include "gsut/geometry/rotation_vector.h"
#include "gsut/sfm/bundle_problem.h"

namespace gsut {

// A turn ties two bodies. The system joins bodies by points alone, so that each turn gets one,
// which both see by half of the turn's residual e: with the best p,
//   2 |e / 2 + de_first - p|^2 + 2 |e / 2 + de_second + p|^2 = |e + de_first + de_second|^2.
// Three components are two observations of two, one of them empty.
int BundleProblem::AppendTurns(std::vector<ReducedSystem::Dependence>* observations) const {
  int point = static_cast<int>(state_.points.size());
  for (const TurnPrior& turn : options_.turn_priors) {
    for (const bool is_first : {true, true, false, false}) {
      ReducedSystem::Dependence& own = observations->emplace_back();
      own.point = point;
      for (const int block : {body_block_[BodyOf(is_first ? turn.first : turn.second)],
                              is_first ? calibration_block_ : -1}) {
        if (block >= 0) own.blocks[own.num_blocks++] = block;
      }
    }
    ++point;
  }
  return static_cast<int>(options_.turn_priors.size());
}

// The residual of a turn is the vector of R_second R_first^T R^T, less what the calibration adds to
// R; see AppendTurns.
double BundleProblem::EvaluateTurns() {
  double cost = 0.0;
  int row = static_cast<int>(bundle_.observations.size());
  for (const TurnPrior& turn : options_.turn_priors) {
    const int first = BodyOf(turn.first), second = BodyOf(turn.second);
    const Eigen::Matrix3d found = RotationOf(state_.poses[second].data()) *
                                  RotationOf(state_.poses[first].data()).transpose();
    Eigen::Vector3d residual = VectorOfRotation(found * turn.rotation.transpose());
    residual -= turn.by_calibration * state_.calibration;
    const double weight = options_.noise / turn.sigma;
    cost += 0.5 * weight * weight * residual.squaredNorm();
    // A turn w of the second camera is one of the residual, -R w of the first one.
    const double half = std::sqrt(2.0) * weight;
    const Eigen::Vector3d own = 0.5 * half * residual;
    WriteHalfTurn(
        row, own, -half,
        {{body_block_[first], -half * found}, {calibration_block_, -half * turn.by_calibration}});
    WriteHalfTurn(row + 2, own, half, {{body_block_[second], half * Eigen::Matrix3d::Identity()}});
    row += 4;
  }
  if (calibration_block_ >= 0) {
    Eigen::VectorXd& residuals = system_->PriorResiduals(calibration_block_);
    residuals = system_->PriorWeights(calibration_block_).cwiseProduct(state_.calibration);
    cost += 0.5 * residuals.squaredNorm();
  }
  return cost;
}

// Three components as two observations, from a row on. by_point: their derivative by that
// coordinate of the turn's point; by_blocks: by a body's turn, or all of the calibration.
void BundleProblem::WriteHalfTurn(int row, const Eigen::Vector3d& residual, double by_point,
                                  const std::vector<std::pair<int, Eigen::Matrix3Xd>>& by_blocks) {
  for (int k = 0; k < 4; ++k) {
    const int i = row + k / 2, r = k % 2;
    system_->Residual(i)[r] = k < 3 ? residual[k] : 0.0;
    system_->ByPoint(i).row(r).setZero();
    if (k < 3) system_->ByPoint(i)(r, k) = by_point;
    double* out = system_->ByBlocks(i);  // row-major, one block after the other
    for (const auto& [block, by] : by_blocks) {
      if (block < 0) continue;
      const int size = sizes_[block], before = block == calibration_block_ ? 0 : 3;
      Eigen::Map<Eigen::RowVectorXd> into(out + static_cast<std::ptrdiff_t>(r) * size, size);
      into.setZero();
      if (k < 3) into.segment(before, by.cols()) = by.row(k);
      for (int column = 0; column < size; ++column) {
        if (system_->Held(block)[column]) into[column] = 0.0;
      }
      out += 2 * static_cast<std::ptrdiff_t>(size);
    }
  }
}

// Three components are two observations of two, one of them empty, as for turns.
void BundleProblem::AppendPointPriors(std::vector<ReducedSystem::Dependence>* observations) const {
  for (const PointPrior& prior : options_.point_priors) {
    for (int k = 0; k < 2; ++k) observations->emplace_back().point = prior.point;
  }
}

double BundleProblem::EvaluatePointPriors() {
  double cost = 0.0;
  int row = static_cast<int>(bundle_.observations.size() + 4 * options_.turn_priors.size());
  for (const PointPrior& prior : options_.point_priors) {
    const Eigen::Vector3d weights = options_.noise * prior.sigma.cwiseInverse();
    const Eigen::Vector3d residual = weights.cwiseProduct(state_.points[prior.point] - prior.mean);
    cost += 0.5 * residual.squaredNorm();
    for (int k = 0; k < 4; ++k) {
      const int i = row + k / 2, r = k % 2;
      system_->Residual(i)[r] = k < 3 ? residual[k] : 0.0;
      system_->ByPoint(i).row(r).setZero();
      if (k < 3) system_->ByPoint(i)(r, k) = weights[k];
    }
    row += 2;
  }
  return cost;
}

}  // namespace gsut
