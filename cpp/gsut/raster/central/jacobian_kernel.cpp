// The derivatives of colours, compiled once per instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gsut/raster/central/jacobian_kernel.cpp"
#include "gsut/base/hwy_targets.h"

#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

#include "gsut/raster/central/jacobian_kernel.h"

#include "gsut/raster/central/jacobian-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// The flag becomes a constant of the build, so that each of its values has a loop of its own.
void Jacobian(const RasterTask& task, const TileGrid& grid, int tile, const Frame& frame,
              const float* shading, std::uint64_t wanted, float* slopes) {
  WithFlag(shading != nullptr, [&](auto with_shading) HWY_ATTR {
    TileJacobian(with_shading, task, grid, tile, frame, shading, wanted, slopes);
  });
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gsut {
HWY_EXPORT(Jacobian);

void JacobianKernel(const RasterTask& task, const TileGrid& grid, int tile, const Frame& frame,
                    const float* shading, std::uint64_t wanted, float* slopes) {
  HWY_DYNAMIC_DISPATCH(Jacobian)(task, grid, tile, frame, shading, wanted, slopes);
}

}  // namespace gsut
#endif
