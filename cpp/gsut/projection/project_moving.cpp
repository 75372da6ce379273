// A lens with its moving camera around it, given to the unscented transform as one lens.
#include "gsut/projection/project_moving.h"

#include <algorithm>
#include <cmath>

#include "gsut/base/parallel.h"
#include "gsut/cameras/lens_registry.h"
#include "gsut/cameras/scalar_math.h"
#include "gsut/gaussians/activations.h"
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

constexpr std::int64_t kGrain = 64;
constexpr int kMaxSteps = 50;
constexpr double kSettled = 1e-9;  // of the exposure

// What stands for the parameters of the lens; `converged` is cleared by points that do not settle.
struct MovingParams {
  const Camera* camera;
  const CameraMotion* motion;
  bool* converged;
};

// Projects points of the world.
template <class Lens>
struct MovingLens : Lens {
  static bool Project(const LensDomain& domain, const MovingParams* params, int num_params,
                      double x, double y, double z, double* u, double* v) {
    const Camera& camera = *params->camera;
    const CameraMotion& motion = *params->motion;
    const Eigen::Vector3d point(x, y, z);
    double t = motion.MiddleTime();
    for (int step = 0; step < kMaxSteps; ++step) {
      const Pose pose = motion.At(t);
      const Eigen::Vector3d seen = pose.rotation * point + pose.translation;
      if (!Lens::Project(domain, camera.params().data(), num_params, seen.x(), seen.y(), seen.z(),
                         u, v)) {
        return false;
      }
      const double next =
          std::clamp(motion.shutter.PixelTime(*u, *v, camera.width(), camera.height()), 0.0, 1.0);
      if (std::abs(next - t) <= kSettled) return true;
      t = next;
    }
    *params->converged = false;
    return false;
  }
};

}  // namespace

void ProjectMoving(const GaussiansView<const double>& gaussians, const Camera& camera,
                   const CameraMotion& motion, const UnscentedOptions& options, double* means,
                   double* covariances, std::uint8_t* valid, std::uint8_t* converged) {
  const UnscentedWeights weights = MakeUnscentedWeights(options);
  VisitLens(camera.lens(), [&](auto model) {
    using Lens = decltype(model);
    const HWY_NAMESPACE::ImagePeriod period =
        HWY_NAMESPACE::PeriodOf<Lens>(camera.domain(), camera.params().data());
    ParallelFor(gaussians.size, kGrain, [&](std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        double r[9], axes[3][3], scale[3];
        RotationFromQuaternion(gaussians.quats + 4 * i, r);
        for (int k = 0; k < 3; ++k) {
          scale[k] = ScaleFromLog(gaussians.log_scales[3 * i + k]);
          for (int row = 0; row < 3; ++row) axes[k][row] = r[3 * row + k];
        }
        bool settled = true;
        const MovingParams params = {&camera, &motion, &settled};
        const auto footprint = HWY_NAMESPACE::Unscented<MovingLens<Lens>, double>(
            camera.domain(), &params, camera.num_params(), period, weights, gaussians.means + 3 * i,
            axes, scale);
        WriteFootprint(footprint, i, means, covariances, valid);
        converged[i] = settled;
      }
    });
  });
}

}  // namespace gsut
