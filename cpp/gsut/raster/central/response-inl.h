// The response of one Gaussian along the rays of a block, from its record in the tile's frame.
//
// A ray is d = (1, s, t) in the tile's frame. frame.h defines the forms p = a.d, q = b.d, z = c.d,
// N = p^2 + q^2 and u = N / (z^2 + k N). All passes evaluate them here, with the same operations in
// the same order: what the forward pass drew, the backward passes find again, bit by bit.

#if defined(GSUT_RASTER_CENTRAL_RESPONSE_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_RASTER_CENTRAL_RESPONSE_INL_H_
#undef GSUT_RASTER_CENTRAL_RESPONSE_INL_H_
#else
#define GSUT_RASTER_CENTRAL_RESPONSE_INL_H_
#endif

#include "gsut/raster/tile_math-inl.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {

// The forms of one record along a block's rays.
struct RayForms {
  FloatVec p, q;
  FloatVec z;   // 0 where negative: the Gaussian is behind
  FloatVec n;   // N
  FloatVec zz;  // z^2
  // Whether alpha reaches its minimum.
  HWY_INLINE FloatMask IsHit() const { return hn::Lt(n, zz); }
  // z^2 + k N; 0 or infinite for some misses.
  HWY_INLINE FloatVec Denominator(FloatVec k) const { return hn::MulAdd(k, n, zz); }
};

HWY_INLINE RayForms FormsAlong(const float* r, FloatVec s, FloatVec t) {
  RayForms forms;
  forms.p = LinearForm(r + record::kA, s, t);
  forms.q = LinearForm(r + record::kB, s, t);
  forms.z = hn::Max(LinearForm(r + record::kC, s, t), hn::Zero(FloatTag()));
  forms.n = hn::MulAdd(forms.p, forms.p, hn::Mul(forms.q, forms.q));
  forms.zz = hn::Mul(forms.z, forms.z);
  return forms;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
