// Holds the parameters of lenses that a solver may not change.
#include "gsut/sfm/lens_parameters.h"

#include "gsut/base/errors.h"

namespace gsut {

void CheckLensFlags(const std::vector<Camera>& cameras,
                    const std::vector<std::vector<std::uint8_t>>& lens_free) {
  if (lens_free.empty()) return;
  bool fits = lens_free.size() == cameras.size();
  for (std::size_t c = 0; fits && c < cameras.size(); ++c) {
    fits = lens_free[c].empty() || static_cast<int>(lens_free[c].size()) == cameras[c].num_params();
  }
  if (!fits) throw InputError("lens_free must have one flag a parameter of each camera");
}

void HoldLensParameters(const std::vector<std::uint8_t>& free, double* lens,
                        ceres::Problem* problem,
                        std::vector<std::unique_ptr<ceres::Manifold>>* manifolds) {
  std::vector<int> held;
  for (std::size_t k = 0; k < free.size(); ++k) {
    if (!free[k]) held.push_back(static_cast<int>(k));
  }
  if (held.size() == free.size()) {
    problem->SetParameterBlockConstant(lens);
  } else if (!held.empty()) {
    manifolds->push_back(
        std::make_unique<ceres::SubsetManifold>(static_cast<int>(free.size()), held));
    problem->SetManifold(lens, manifolds->back().get());
  }
}

}  // namespace gsut
