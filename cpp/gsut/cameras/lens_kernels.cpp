// The vectorised lenses: pixels, compiled once per instruction set and lens.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/cameras/lens_kernels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/base/lanes-inl.h"
#include "gsut/cameras/contract.h"
#include "gsut/cameras/lens_kernels.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace lane_lenses {
#include "gsut_lens_files.inc"
}  // namespace lane_lenses

template <class Lens>
HWY_NOINLINE void ProjectLens(const FloatLens& lens, int count, const LensBatch& batch) {
  Lane scalars[kMaxScalarParams];
  const auto* params = [&] {
    if constexpr (requires { Lens::kHasTable; }) {
      return lens.params.data();
    } else {
      for (int i = 0; i < lens.num_params; ++i) scalars[i] = Lane(lens.params[i]);
      return static_cast<const Lane*>(scalars);
    }
  }();
  const FloatTag d;
  const Lane nan(static_cast<double>(__builtin_nanf("")));
  for (int i = 0; i < count; i += kLanes) {
    const Lane x(hn::Load(d, batch.x + i)), y(hn::Load(d, batch.y + i)),
        z(hn::Load(d, batch.z + i));
    Lane u, v;
    const LaneMask valid = Lens::Project(lens.domain, params, lens.num_params, x, y, z, &u, &v);
    hn::Store(Select(valid, u, nan).v, d, batch.u + i);
    hn::Store(Select(valid, v, nan).v, d, batch.v + i);
  }
}

void ProjectLanes(const FloatLens& lens, int count, const LensBatch& batch) {
  using Kernel = void (*)(const FloatLens&, int, const LensBatch&);
  static constexpr Kernel kKernels[] = {
#define GSUT_LENS_KERNEL(Lens) &ProjectLens<lane_lenses::Lens>,
      GSUT_FOR_EACH_LENS(GSUT_LENS_KERNEL)
#undef GSUT_LENS_KERNEL
  };
  kKernels[static_cast<int>(lens.lens)](lens, count, batch);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(ProjectLanes);

void ProjectPoints(const FloatLens& lens, int count, const LensBatch& batch) {
  HWY_DYNAMIC_DISPATCH(ProjectLanes)(lens, count, batch);
}

}  // namespace gsut
#endif
