// Projection in float (threads over the kernels) and in double (the reference).
#include "gsut/projection/project.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "gsut/base/check_arguments.h"
#include "gsut/base/errors.h"
#include "gsut/gaussians/check_gaussians.h"
#include "gsut/base/parallel.h"
#include "gsut/projection/project_kernels.h"
#include "gsut/projection/unscented_scalar.h"

namespace gsut {
namespace {

// Splats are padded so that the kernels may write whole vectors.
constexpr std::size_t kPadding = 16;
constexpr std::int64_t kGrain = 4096;
// Footprints wider than this (pixels) are not trusted to an ellipse.
constexpr float kWideFootprint = 64.0f;
// Where the central weight exceeds this (alpha below about 0.4), pixel differences of the sigma
// points are magnified beyond the precision of float pixels: they are formed in double.
constexpr double kLargestFloatWeight = 10.0;

// Calls use(i, footprint) for the Gaussians [begin, end), in double.
template <class T, class Use>
void ForEachFootprint(const GaussiansView<const T>& gaussians, const Camera& camera,
                      const Pose& camera_from_world, const UnscentedWeights& weights,
                      std::int64_t begin, std::int64_t end, Use&& use) {
  std::vector<std::uint8_t> valid(HWY_NAMESPACE::kUnscentedPoints * kScalarBatch);
  const auto through = [&](std::int64_t, std::int64_t count, const double* points, double* pixels) {
    camera.Project(count, points, pixels, valid.data());
  };
  UnscentedInDouble(gaussians, camera_from_world, camera.domain(), weights, begin, end, through,
                    use);
}

// Replaces the kernel's pixel quantities by ones formed in double.
void RefineInDouble(const GaussiansView<const float>& gaussians, const Camera& camera,
                    const Pose& camera_from_world, const UnscentedWeights& weights,
                    const FootprintRule& rule, std::int64_t begin, std::int64_t end,
                    Splats* splats) {
  const auto replace = [&](std::int64_t i, const ScalarFootprint& footprint) {
    const std::size_t j = static_cast<std::size_t>(i);
    if (std::isnan(footprint.u)) return;
    const double cutoff = CutoffOf(gaussians, i, rule);
    const double reach = std::sqrt(std::max(cutoff, 0.0));
    splats->u[j] = static_cast<float>(footprint.u);
    splats->v[j] = static_cast<float>(footprint.v);
    splats->cov_uu[j] = static_cast<float>(footprint.cov_uu);
    splats->cov_uv[j] = static_cast<float>(footprint.cov_uv);
    splats->cov_vv[j] = static_cast<float>(footprint.cov_vv);
    splats->extent_u[j] = static_cast<float>(reach * std::sqrt(footprint.cov_uu));
    splats->extent_v[j] = static_cast<float>(reach * std::sqrt(footprint.cov_vv));
  };
  ForEachFootprint(gaussians, camera, camera_from_world, weights, begin, end, replace);
}

void CheckOutputs(std::int64_t size, const double* means, const double* covariances,
                  const std::uint8_t* valid) {
  CheckArray(means, size, "means");
  CheckArray(covariances, size, "covariances");
  CheckArray(valid, size, "valid");
}

}  // namespace

// Julier and Uhlmann (1997) with n = 3 dimensions: points at the mean and at sqrt(n + lambda)
// deviations along each axis, n + lambda = alpha^2 (n + kappa).
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

// strength exp(-D^2 / 2) >= raw, that of alpha_min, where D^2 <= 2 ln(strength / raw); below 0:
// never drawn.
double CutoffOf(double strength, Response response, const FootprintRule& rule,
                const Profile& profile) {
  double cutoff = 2.0 * std::log(strength / RawOf(response, rule.alpha_min));
  if (rule.response_min > 0.0) cutoff = std::min(cutoff, -2.0 * std::log(rule.response_min));
  return profile.IsGaussian() || !(cutoff > 0.0) ? cutoff : profile.Cutoff(cutoff);
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
  CheckGaussians(gaussians);
  CheckGiven(splats, "splats");
  const float max_cutoff = rule.response_min > 0.0
                               ? static_cast<float>(-2.0 * std::log(rule.response_min))
                               : std::numeric_limits<float>::max();
  const ProjectTask task = {gaussians,
                            FloatLens(camera),  // throws InputError if the kernels cannot take it
                            MakeViewFloats(camera_from_world),
                            static_cast<float>(Log2RawOf(gaussians.response, rule.alpha_min)),
                            max_cutoff,
                            camera.width(),
                            camera.height(),
                            MakeUnscentedWeights(options),
                            kWideFootprint};
  splats->Resize(gaussians.size);
  // The kernel in float; once more in double where float would not do for these weights.
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
  CheckGaussians(gaussians);
  CheckOutputs(gaussians.size, means, covariances, valid);
  const UnscentedWeights weights = MakeUnscentedWeights(options);
  ParallelFor(gaussians.size, kGrain, [&](std::int64_t begin, std::int64_t end) {
    ForEachFootprint(gaussians, camera, camera_from_world, weights, begin, end,
                     [&](std::int64_t i, const ScalarFootprint& footprint) {
                       WriteFootprint(footprint, i, means, covariances, valid);
                     });
  });
}

// The covariance is summed axis by axis as the outer products of J (s_k q_k).
void ProjectEwaReference(const GaussiansView<const double>& gaussians, const Camera& camera,
                         const Pose& camera_from_world, double* means, double* covariances,
                         std::uint8_t* valid) {
  CheckGaussians(gaussians);
  CheckOutputs(gaussians.size, means, covariances, valid);
  ParallelFor(gaussians.size, kGrain, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      const PlacedGaussian<double> g = PlaceInDouble(gaussians, i, camera_from_world);
      double pixel[2];
      std::uint8_t has_pixel = 0;
      Eigen::Matrix<double, 2, 3, Eigen::RowMajor> dpixel_dpoint;
      camera.ProjectJacobian(1, g.mean, pixel, &has_pixel, dpixel_dpoint.data(), nullptr);
      Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
      for (int k = 0; k < 3; ++k) {
        const Eigen::Vector2d along =
            dpixel_dpoint * (g.scale[k] * Eigen::Map<const Eigen::Vector3d>(g.axes[k]));
        covariance += along * along.transpose();
      }
      const double u = has_pixel ? pixel[0] : std::numeric_limits<double>::quiet_NaN();
      WriteFootprint({u, pixel[1], covariance(0, 0), covariance(0, 1), covariance(1, 1)}, i, means,
                     covariances, valid);
    }
  });
}

}  // namespace gsut
