// The lenses that the build found: enumeration and lookup by name.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "gsut/cameras/lens_domain.h"
#include "gsut_lens_list.h"

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

}  // namespace gsut
