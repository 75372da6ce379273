// A table of the lenses' vector kernels for one kind of scalar, one entry a lens.

#if defined(GSUT_CAMERAS_LENS_KERNELS_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_CAMERAS_LENS_KERNELS_INL_H_
#undef GSUT_CAMERAS_LENS_KERNELS_INL_H_
#else
#define GSUT_CAMERAS_LENS_KERNELS_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/cameras/contract.h"
#include "gsut/cameras/dual_lanes-inl.h"
#include "gsut/cameras/lens_kernels.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace lane_lenses {
#include "gsut_lens_files.inc"
}  // namespace lane_lenses

HWY_INLINE Lane Variable(Lane value, int /*direction*/, Lane /*kind*/) { return value; }
HWY_INLINE DualLane Variable(Lane value, int direction, const DualLane& /*kind*/) {
  return DualLane(value, direction);
}

HWY_INLINE void StorePixel(LaneMask valid, Lane u, Lane v, const LensBatch& batch, int i) {
  const FloatTag d;
  const Lane nan(static_cast<double>(__builtin_nanf("")));
  hn::Store(Select(valid, u, nan).v, d, batch.u + i);
  hn::Store(Select(valid, v, nan).v, d, batch.v + i);
}

HWY_INLINE void StorePixel(LaneMask valid, const DualLane& u, const DualLane& v,
                           const LensBatch& batch, int i) {
  StorePixel(valid, u.value, v.value, batch, i);
  const FloatTag d;
  for (int k = 0; k < DualLane::kDirections; ++k) {
    hn::Store(u.grad[k].v, d, batch.du[k] + i);
    hn::Store(v.grad[k].v, d, batch.dv[k] + i);
  }
}

template <class Lens, class T>
HWY_NOINLINE void ProjectLens(const FloatLens& lens, int count, const LensBatch& batch) {
  T scalars[kMaxScalarParams];
  const auto* params = [&] {
    if constexpr (requires { Lens::kHasTable; }) {
      return lens.params.data();
    } else {
      for (int i = 0; i < lens.num_params; ++i) scalars[i] = T(lens.params[i]);
      return static_cast<const T*>(scalars);
    }
  }();
  const FloatTag d;
  for (int i = 0; i < count; i += kLanes) {
    const T x = Variable(Lane(hn::Load(d, batch.x + i)), 0, T());
    const T y = Variable(Lane(hn::Load(d, batch.y + i)), 1, T());
    const T z = Variable(Lane(hn::Load(d, batch.z + i)), 2, T());
    T u, v;
    const LaneMask valid = Lens::Project(lens.domain, params, lens.num_params, x, y, z, &u, &v);
    StorePixel(valid, u, v, batch, i);
  }
}

// T: Lane or DualLane.
template <class T>
void ProjectAnyLens(const FloatLens& lens, int count, const LensBatch& batch) {
  using Kernel = void (*)(const FloatLens&, int, const LensBatch&);
  static constexpr Kernel kKernels[] = {
#define GSUT_LENS_KERNEL(Lens) &ProjectLens<lane_lenses::Lens, T>,
      GSUT_FOR_EACH_LENS(GSUT_LENS_KERNEL)
#undef GSUT_LENS_KERNEL
  };
  kKernels[static_cast<int>(lens.lens)](lens, count, batch);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
