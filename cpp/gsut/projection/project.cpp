// Projection in float (threads over the kernels) and in double (the reference).
#include "gsut/projection/project.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/base/parallel.h"
#include "gsut/cameras/lens_registry.h"
#include "gsut/cameras/scalar_math.h"
#include "gsut/gaussians/activations.h"
#include "gsut/projection/project_kernels.h"
#include "gsut/projection/projection_steps.h"

// The scalar names that the transform's text uses; before its text.
#include <hwy/highway.h>
namespace gsut::HWY_NAMESPACE {
using lenses::AndMask;
using lenses::OrMask;
using lenses::Select;
}  // namespace gsut::HWY_NAMESPACE
#include "gsut/projection/unscented-inl.h"

namespace gsut {
namespace {

// Splats are padded so that the kernels may write whole vectors.
constexpr std::size_t kPadding = 16;
constexpr std::int64_t kGrain = 4096;
// Footprints wider than this (pixels) are not trusted to an ellipse.
constexpr float kWideFootprint = 64.0f;
// Where the central weight exceeds this (alpha below about 0.4), pixel differences of the sigma
// points are so much magnified that float pixels do not suffice: they are formed in double.
constexpr double kLargestFloatWeight = 10.0;

// Footprint of Gaussian i in double.
template <class T>
auto FootprintOf(const GaussiansView<const T>& gaussians, std::int64_t i, const Camera& camera,
                 const Pose& camera_from_world, const UnscentedWeights& weights) {
  const Eigen::Vector3d mean =
      camera_from_world.rotation * Eigen::Map<const Eigen::Matrix<T, 3, 1>>(gaussians.means + 3 * i)
                                       .template cast<double>() +
      camera_from_world.translation;
  double quat[4], r[9];
  for (int k = 0; k < 4; ++k) quat[k] = static_cast<double>(gaussians.quats[4 * i + k]);
  RotationFromQuaternion(quat, r);
  const Eigen::Matrix3d q = camera_from_world.rotation *
                            Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(r);
  double axes[3][3], scale[3];
  for (int k = 0; k < 3; ++k) {
    scale[k] = ScaleFromLog(static_cast<double>(gaussians.log_scales[3 * i + k]));
    for (int row = 0; row < 3; ++row) axes[k][row] = q(row, k);
  }
  return VisitLens(camera.lens(), [&](auto lens) {
    using Lens = decltype(lens);
    const double* params = camera.params().data();
    return HWY_NAMESPACE::Unscented<Lens, double>(
        camera.domain(), params, camera.num_params(),
        HWY_NAMESPACE::PeriodOf<Lens>(camera.domain(), params), weights, mean.data(), axes, scale);
  });
}

// Replaces the kernel's pixel quantities by ones formed in double.
void RefineInDouble(const GaussiansView<const float>& gaussians, const Camera& camera,
                    const Pose& camera_from_world, const UnscentedWeights& weights,
                    const FootprintRule& rule, std::int64_t begin, std::int64_t end,
                    Splats* splats) {
  for (std::int64_t i = begin; i < end; ++i) {
    const std::size_t j = static_cast<std::size_t>(i);
    const auto footprint = FootprintOf(gaussians, i, camera, camera_from_world, weights);
    if (!footprint.all_valid) continue;
    const double cutoff = CutoffOf(Sigmoid(static_cast<double>(gaussians.opacity_logits[i])), rule);
    const double reach = std::sqrt(std::max(cutoff, 0.0));
    splats->u[j] = static_cast<float>(footprint.u);
    splats->v[j] = static_cast<float>(footprint.v);
    splats->cov_uu[j] = static_cast<float>(footprint.cov_uu);
    splats->cov_uv[j] = static_cast<float>(footprint.cov_uv);
    splats->cov_vv[j] = static_cast<float>(footprint.cov_vv);
    splats->extent_u[j] = static_cast<float>(reach * std::sqrt(footprint.cov_uu));
    splats->extent_v[j] = static_cast<float>(reach * std::sqrt(footprint.cov_vv));
  }
}

}  // namespace

UnscentedWeights MakeUnscentedWeights(const UnscentedOptions& options) {
  // 3 + lambda, formed without lambda: nearly -3 for a small alpha, it would lose digits.
  const double reach = options.alpha * options.alpha * (3.0 + options.kappa);
  if (!(options.alpha > 0.0) || !std::isfinite(options.beta) || !(reach > 0.0) ||
      !std::isfinite(reach)) {
    throw InputError("unscented transform: alpha " + std::to_string(options.alpha) + ", beta " +
                     std::to_string(options.beta) + ", kappa " + std::to_string(options.kappa) +
                     " give no sigma points; alpha must be positive and kappa above -3");
  }
  UnscentedWeights weights;
  weights.spread = std::sqrt(reach);
  weights.mean_0 = (reach - 3.0) / reach;
  weights.mean_i = 0.5 / reach;
  weights.cov_0 = weights.mean_0 + 1.0 - options.alpha * options.alpha + options.beta;
  return weights;
}

double CutoffOf(double opacity, const FootprintRule& rule) {
  const double by_alpha = 2.0 * std::log(opacity / rule.alpha_min);
  if (!(rule.response_min > 0.0)) return by_alpha;
  return std::min(by_alpha, -2.0 * std::log(rule.response_min));
}

void Splats::Resize(std::int64_t n) {
  size = n;
  const std::size_t padded = static_cast<std::size_t>(n) + kPadding;
  for (AlignedVector<float>* array :
       {&u, &v, &cov_uu, &cov_uv, &cov_vv, &extent_u, &extent_v, &distance, &sine}) {
    array->resize(padded);
  }
  status.resize(padded);
}

void Project(const GaussiansView<const float>& gaussians, const Camera& camera,
             const Pose& camera_from_world, const UnscentedOptions& options,
             const FootprintRule& rule, Splats* splats) {
  ProjectTask task;
  std::vector<float> table;
  DescribeCamera(gaussians, camera, camera_from_world, rule, "rendered", &table, &task);
  task.width = camera.width();
  task.height = camera.height();
  task.weights = MakeUnscentedWeights(options);
  task.wide = kWideFootprint;
  splats->Resize(gaussians.size);
  ParallelFor(gaussians.size, kGrain, [&](std::int64_t begin, std::int64_t end) {
    ProjectKernel(task, begin, end, splats);
    if (std::abs(task.weights.mean_0) > kLargestFloatWeight) {
      RefineInDouble(gaussians, camera, camera_from_world, task.weights, rule, begin, end, splats);
    }
  });
}

void ProjectReference(const GaussiansView<const double>& gaussians, const Camera& camera,
                      const Pose& camera_from_world, const UnscentedOptions& options, double* means,
                      double* covariances, std::uint8_t* valid) {
  const UnscentedWeights weights = MakeUnscentedWeights(options);
  ParallelFor(gaussians.size, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const auto footprint = FootprintOf(gaussians, i, camera, camera_from_world, weights);
      WriteFootprint(footprint, i, means, covariances, valid);
    }
  });
}

}  // namespace gsut
