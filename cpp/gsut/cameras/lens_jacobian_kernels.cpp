// The vectorised lenses: pixels with their derivatives, compiled once per instruction set and lens.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/cameras/lens_jacobian_kernels.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/cameras/lens_kernels-inl.h"
#include "gsut/cameras/lens_kernels.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

void ProjectDualLanes(const FloatLens& lens, int count, const LensBatch& batch) {
  ProjectAnyLens<DualLane>(lens, count, batch);
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(ProjectDualLanes);

void ProjectPointsJacobian(const FloatLens& lens, int count, const LensBatch& batch) {
  HWY_DYNAMIC_DISPATCH(ProjectDualLanes)(lens, count, batch);
}

}  // namespace gsut
#endif
