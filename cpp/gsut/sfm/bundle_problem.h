// A bundle as blocks of unknowns, residuals and their derivatives.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "gsut/sfm/bundle.h"
#include "gsut/sfm/bundle_state.h"
#include "gsut/sfm/lens_evaluation.h"
#include "gsut/sfm/reduced_system.h"

namespace gsut {

// Throws InputError if an observation names an image or a point that is not there.
void CheckObservations(const Bundle& bundle);

class BundleProblem {
 public:
  // Both are kept by reference.
  BundleProblem(const Bundle& bundle, const BundleOptions& options);
  BundleProblem(const BundleProblem&) = delete;  // its lenses read its state
  BundleProblem& operator=(const BundleProblem&) = delete;

  // Residuals and derivatives at the current unknowns, for the system; the cost, not finite where
  // there is none.
  double Evaluate();
  ReducedSystem& system() { return *system_; }
  // Adds the system's step to the unknowns; whether it is too small to matter.
  bool Step();
  const BundleState& state() const { return state_; }
  void Restore(const BundleState& state) { state_ = state; }

  // Writes what was solved for.
  void Store(Bundle* bundle) const;

 private:
  int BodyOf(int image) const { return image < 0 ? -1 : state_.body_of_image[image]; }
  // Whether a body's block holds a velocity too.
  bool Moves(int block) const { return sizes_[block] > kPoseTangent; }
  void MakeBlocks();
  void MakeSystem();
  Eigen::MatrixXd SimilarityMotions(int body, int block) const;
  // Residuals of what is known of places, velocities, mounts and lenses beforehand; returns their
  // cost.
  double EvaluatePriors();
  double EvaluateLensPriors();
  // Adds the observations of turns, after all others; returns their points.
  int AppendTurns(std::vector<ReducedSystem::Dependence>* observations) const;
  double EvaluateTurns();
  // Adds the observations of stated points, after those of turns.
  void AppendPointPriors(std::vector<ReducedSystem::Dependence>* observations) const;
  double EvaluatePointPriors();
  void WriteHalfTurn(int row, const Eigen::Vector3d& residual, double by_point,
                     const std::vector<std::pair<int, Eigen::Matrix3Xd>>& by_blocks);
  // Whether something is known of a camera's lens that is estimated.
  bool HasPrior(std::size_t camera) const {
    return lens_block_[camera] >= 0 && !options_.lens_priors.empty() &&
           !options_.lens_priors[camera].sigma.empty();
  }
  // Of one observation; returns its cost.
  double Linearize(int i);

  const Bundle& bundle_;
  const BundleOptions& options_;
  BundleState state_;
  int gauge_body_, scale_body_;
  std::unique_ptr<LensEvaluation> evaluation_;
  std::vector<std::uint8_t> used_body_, fixed_body_, used_lens_, used_mount_;
  // The system's blocks: of a body its pose and, if it moves, velocity; -1: stays as it is.
  std::vector<int> sizes_, body_block_, mount_block_, lens_block_;
  int calibration_block_ = -1;
  int num_bodies_ = 0;                         // among the blocks
  std::vector<Eigen::MatrixXd> lens_columns_;  // of all parameters, and of the free ones only
  std::vector<Eigen::MatrixXd> free_columns_;
  std::vector<std::vector<int>> lens_params_;  // of each column the first parameter it moves
  std::unique_ptr<ReducedSystem> system_;
};

}  // namespace gsut
