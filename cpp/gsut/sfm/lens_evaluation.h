// All points of a bundle through its lenses, once for each step of the solver.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "gsut/sfm/bundle.h"
#include "gsut/sfm/bundle_state.h"

namespace gsut {

// Residuals are made one at a time, a lens works on batches: everything is projected beforehand,
// and each residual reads its row. A lens whose parameters have become no lens marks all its
// observations as failed, which makes the solver take a shorter step.
class LensEvaluation {
 public:
  // Both are kept by reference: the state is the solver's. lens_free: see BundleOptions.
  LensEvaluation(const Bundle& bundle, const BundleState& state,
                 const std::vector<std::vector<std::uint8_t>>& lens_free);

  // At the current unknowns, with derivatives.
  void Evaluate();

  struct Row {
    const double* pixel;  // (2), NaN outside the lens' domain; the copy nearest to that seen
    const double* dpixel_dpoint;   // (2, 3) row-major
    const double* dpixel_dparams;  // (2, F) row-major, by its lens' free parameters; null: none
    bool valid;                    // inside the lens' domain
    bool lens_failed;
  };
  // Row of an observation.
  Row Get(int observation) const;

 private:
  struct Batch {  // the observations through one camera
    std::vector<int> observations;
    std::vector<int> free;  // parameters of its lens
    std::vector<double> points, pixels, by_point, by_params;
    std::vector<std::uint8_t> valid;
    bool failed = false;
  };
  void EvaluateBatch(int camera);

  const Bundle& bundle_;
  const BundleState& state_;
  std::vector<Batch> batches_;
  std::vector<int> place_;  // of an observation within its batch
};

}  // namespace gsut
