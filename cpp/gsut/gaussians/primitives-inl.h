// The primitives' text for vectors, and the dispatch to it: once a call, the same for all lanes.

#if defined(GSUT_GAUSSIANS_PRIMITIVES_INL_H_) == defined(HWY_TARGET_TOGGLE)
#ifdef GSUT_GAUSSIANS_PRIMITIVES_INL_H_
#undef GSUT_GAUSSIANS_PRIMITIVES_INL_H_
#else
#define GSUT_GAUSSIANS_PRIMITIVES_INL_H_
#endif

#include "gsut/base/lanes-inl.h"
#include "gsut/gaussians/primitive.h"

HWY_BEFORE_NAMESPACE();
namespace gsut {
namespace HWY_NAMESPACE {
namespace lane_primitives {

// Highway's Exp is garbage far below 0, where 2^x is 0.
HWY_INLINE Lane Exp2(Lane x) {
  constexpr double kLn2 = 0.69314718055994530942;
  constexpr double kLeast = -120.0;
  return Exp(Lane(kLn2) * Max(x, Lane(kLeast)));
}

#include "gsut_primitive_files.inc"
}  // namespace lane_primitives

// Calls visitor(lane_primitives::Beta()) for kBeta, and so on.
template <class Visitor>
HWY_INLINE void VisitPrimitive(Primitive primitive, const Visitor& visitor) {
  switch (primitive) {
#define GSUT_PRIMITIVE_CASE(Kind)     \
  case Primitive::k##Kind:            \
    visitor(lane_primitives::Kind()); \
    return;
    GSUT_FOR_EACH_PRIMITIVE(GSUT_PRIMITIVE_CASE)
#undef GSUT_PRIMITIVE_CASE
  }
}

// Calls visitor(lane_primitives::Triangle()) for kTriangle, and so on; not for what is not flat.
template <class Visitor>
HWY_INLINE void VisitFlat(Primitive primitive, const Visitor& visitor) {
  VisitPrimitive(primitive, [&](auto kind) HWY_ATTR {
    if constexpr (requires { kind.kEdges; }) visitor(kind);
  });
}

// As IsFlat, without a call: that would cost a loop its registers.
HWY_INLINE bool HasEdges(Primitive primitive) {
  bool has_edges = false;
  VisitFlat(primitive, [&](auto /*kind*/) HWY_ATTR { has_edges = true; });
  return has_edges;
}

// Functions, not text: kernels branch to them once a group of pixels, and only for what is no
// Gaussian. exponents: v, see gaussians/primitive.h, which becomes log2 of the response; shapes:
// those of the exponents, activated.
inline HWY_NOINLINE void ShapeExponents(Primitive primitive, const float* shapes, int count,
                                        FloatVec* exponents) {
  VisitPrimitive(primitive, [&](auto kind) HWY_ATTR {
    for (int i = 0; i < count; ++i) {
      exponents[i] = kind.LogResponse(Lane(exponents[i]), Lane(shapes[i])).v;
    }
  });
}

// The derivatives of log2 of the response by v, and by the shape.
inline HWY_NOINLINE void ShapeSlopes(Primitive primitive, float shape, FloatVec v, FloatVec* by_v,
                                     FloatVec* by_shape) {
  VisitPrimitive(primitive, [&](auto kind) HWY_ATTR {
    *by_v = kind.Slope(Lane(v), Lane(shape)).v;
    *by_shape = kind.ShapeSlope(Lane(v), Lane(shape)).v;
  });
}

// Runs once for each Gaussian of a frame, and for lines once for each pair of a tile: what is drawn
// is bounded by it before any exponential. A cut-off below 0, of what is never drawn, counts as 0.
// D^2 where the response ends, of the one where a Gaussian's would; stored: shapes.
inline HWY_NOINLINE Lane ShapeCutoff(Primitive primitive, Lane stored, Lane gaussian_cutoff) {
  constexpr double kPerSquare = -0.72134752044448170368;
  Lane cutoff = gaussian_cutoff;
  VisitPrimitive(primitive, [&](auto kind) HWY_ATTR {
    const Lane end = Lane(kPerSquare) * Max(gaussian_cutoff, Lane(0.0));
    cutoff = kind.Invert(end, kind.Activate(stored)) * Lane(1.0 / kPerSquare);
  });
  return cutoff;
}

}  // namespace HWY_NAMESPACE
}  // namespace gsut
HWY_AFTER_NAMESPACE();

#endif  // include guard of a per-target header
