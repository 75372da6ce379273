// The scalar text of every lens (double, Dual), and the dispatch to it: for .cpp files of cameras
// only.
#pragma once

#include "gsut/cameras/contract.h"
#include "gsut/cameras/lens_registry.h"
#include "gsut/cameras/scalar_math.h"

namespace gsut::lenses {
#include "gsut_lens_files.inc"
}  // namespace gsut::lenses

namespace gsut {

// Calls visitor(lenses::KannalaBrandt{}) for kKannalaBrandt, and so on: one dispatch a batch, never
// one a point.
template <class Visitor>
auto VisitLens(LensModel lens, Visitor&& visitor) {
  switch (lens) {
#define GSUT_LENS_CASE(Lens) \
  case LensModel::k##Lens:   \
    return visitor(lenses::Lens{});
    GSUT_FOR_EACH_LENS(GSUT_LENS_CASE)
#undef GSUT_LENS_CASE
  }
  __builtin_unreachable();  // LensModel values come from LensFromName only
}

}  // namespace gsut
