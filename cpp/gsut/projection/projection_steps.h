// Steps that the kinds of projection share: what every float kernel is told, and what a footprint
// in double writes.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/cameras/lens_registry.h"
#include "gsut/projection/project.h"
#include "gsut/projection/project_kernels.h"
#include "gsut/projection/view.h"

namespace gsut {

// Fills what ProjectTask and FootprintTask have in common. `table` keeps the parameters of a lens
// with a table and must outlive the task; `verb` is for the error of a lens with too many.
template <class Task>
void DescribeCamera(const GaussiansView<const float>& gaussians, const Camera& camera,
                    const Pose& camera_from_world, const FootprintRule& rule, const char* verb,
                    std::vector<float>* table, Task* task) {
  task->gaussians = gaussians;
  task->lens = camera.lens();
  task->domain = camera.domain();
  task->params = camera.params().data();
  task->num_params = camera.num_params();
  const bool has_table = VisitLens(camera.lens(), [](auto lens) {
    return requires { decltype(lens)::kHasTable; };
  });
  if (task->num_params > kMaxLensParams && !has_table) {
    throw InputError("the lens has " + std::to_string(task->num_params) + " parameters; at most " +
                     std::to_string(kMaxLensParams) + " can be " + verb);
  }
  if (has_table) {
    table->assign(camera.params().begin(), camera.params().end());
    table->resize(table->size() + kMaxColumns);
  }
  task->table = table->data();
  task->view = MakeViewFloats(camera_from_world);
  task->log2_alpha_min = static_cast<float>(std::log2(rule.alpha_min));
  task->max_cutoff = rule.response_min > 0.0
                         ? static_cast<float>(-2.0 * std::log(rule.response_min))
                         : std::numeric_limits<float>::max();
}

// Writes row i of means (N, 2), covariances (N, 2, 2) and valid (N); NaN where a point is invalid.
template <class Footprint>
void WriteFootprint(const Footprint& footprint, std::int64_t i, double* means, double* covariances,
                    std::uint8_t* valid) {
  const bool ok = footprint.all_valid;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  valid[i] = ok;
  means[2 * i] = ok ? footprint.u : nan;
  means[2 * i + 1] = ok ? footprint.v : nan;
  covariances[4 * i] = ok ? footprint.cov_uu : nan;
  covariances[4 * i + 1] = covariances[4 * i + 2] = ok ? footprint.cov_uv : nan;
  covariances[4 * i + 3] = ok ? footprint.cov_vv : nan;
}

}  // namespace gsut
