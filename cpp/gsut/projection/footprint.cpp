// Footprints of many Gaussians: in double by the scalar code, in float the kernels' put together.
#include "gsut/projection/footprint.h"

#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"
#include "gsut/projection/footprint_kernels.h"
#include "gsut/projection/footprint_scalar.h"

namespace gsut {
namespace {

constexpr std::size_t kPadding = 16;
constexpr std::int64_t kGrain = 4096;

}  // namespace

template <class T>
void Footprints<T>::Resize(std::int64_t n) {
  size = n;
  const std::size_t padded = static_cast<std::size_t>(n) + kPadding;
  for (AlignedVector<T>* array :
       {&u, &v, &cov_uu, &cov_uv, &cov_vv, &low_u, &high_u, &low_v, &high_v}) {
    array->resize(padded);
  }
  status.resize(padded);
}

template struct Footprints<float>;
template struct Footprints<double>;

// The same methods in double, one Gaussian at a time: what the kernels are compared with.
void FindFootprintsReference(const GaussiansView<const double>& gaussians, const Camera& camera,
                             const Pose& camera_from_world, const FootprintOptions& options,
                             Footprints<double>* footprints) {
  const ScalarFootprints scalar(camera, camera_from_world, options);
  footprints->Resize(gaussians.size);
  ParallelFor(gaussians.size, 64, [&](std::int64_t begin, std::int64_t end) {
    for (std::int64_t i = begin; i < end; ++i) {
      StoreFootprint(scalar.Find(gaussians, i), 0.0, static_cast<std::size_t>(i), footprints);
    }
  });
}

// In float, a vector of Gaussians at a time. What the kernel leaves open (kUnknown) and lenses
// without one centre go to the scalar code, whose box is widened by the rounding of floats.
void FindFootprints(const GaussiansView<const float>& gaussians, const Camera& camera,
                    const Pose& camera_from_world, const FootprintOptions& options,
                    Footprints<float>* footprints) {
  ActiveIsa();  // applies GSUT_ISA before the first kernel runs
  const bool bounds = options.method == ProjectionMethod::kSilhouette;
  const FootprintTask task = {MakeViewTask(gaussians, camera, camera_from_world, options.rule),
                              options.method, MakeUnscentedWeights(options.unscented)};
  const ScalarFootprints scalar(camera, camera_from_world, options);
  footprints->Resize(gaussians.size);
  ParallelFor(gaussians.size, kGrain, [&](std::int64_t begin, std::int64_t end) {
    if (bounds && !camera.IsCentral()) {
      for (std::int64_t i = begin; i < end; ++i) {
        StoreFootprint(scalar.Find(gaussians, i), kBoxRounding, static_cast<std::size_t>(i),
                       footprints);
      }
      return;
    }
    FootprintKernel(task, begin, end, footprints);
    if (!bounds) return;
    for (std::int64_t i = begin; i < end; ++i) {
      const std::size_t j = static_cast<std::size_t>(i);
      if (footprints->status[j] != FootprintStatus::kUnknown) continue;
      StoreFootprint(scalar.Find(gaussians, i), kBoxRounding, j, footprints);
    }
  });
}

}  // namespace gsut
