// The lenses that the build found: scalar code, enumeration, lookup by name, dispatch.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "gsut/cameras/contract.h"
#include "gsut/cameras/scalar_math.h"
#include "gsut_lens_list.h"

namespace gsut::lenses {
#include "gsut_lens_files.inc"
}  // namespace gsut::lenses

namespace gsut {

// kPinhole, kOpencv5 ...: one value a lens file, in the order of the files' names.
enum class LensModel : int {
#define GSUT_LENS_VALUE(Lens) k##Lens,
  GSUT_FOR_EACH_LENS(GSUT_LENS_VALUE)
#undef GSUT_LENS_VALUE
};

// All names, in the order of LensModel.
std::vector<std::string> LensNames();

// Throws InputError listing all known names if there is no such lens.
LensModel LensFromName(std::string_view name);

const char* LensName(LensModel lens);
const char* LensParamNames(LensModel lens);
std::span<const LensExample> LensExamples(LensModel lens);

// visitor(lenses::KannalaBrandt{}) for the lens asked for: one dispatch a batch, never one a point.
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
