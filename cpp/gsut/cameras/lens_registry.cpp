// The lenses that the build found: lookup by name.
#include "gsut/cameras/lens_registry.h"

#include "gsut/base/errors.h"
#include "gsut/cameras/visit_lens.h"

namespace gsut {
namespace {

struct LensEntry {
  LensModel lens;
  const char* name;
  const char* param_names;
  std::span<const LensExample> examples;
};

// GSUT_FOR_EACH_LENS comes from the build, which lists the files of cameras/models in the order of
// their names; LensModel has the same order, so its value is the index.
constexpr LensEntry kLenses[] = {
#define GSUT_LENS_ENTRY(Lens)                                          \
  {LensModel::k##Lens, lenses::Lens::kName, lenses::Lens::kParamNames, \
   std::span<const LensExample>(lenses::Lens::kExamples)},
    GSUT_FOR_EACH_LENS(GSUT_LENS_ENTRY)
#undef GSUT_LENS_ENTRY
};

const LensEntry& Entry(LensModel lens) { return kLenses[static_cast<int>(lens)]; }

}  // namespace

// In the order of LensModel.
std::vector<std::string> LensNames() {
  std::vector<std::string> names;
  for (const LensEntry& entry : kLenses) names.emplace_back(entry.name);
  return names;
}

// A linear search: lenses are few, and names are looked up once a camera.
LensModel LensFromName(std::string_view name) {
  std::string known;
  for (const LensEntry& entry : kLenses) {
    if (name == entry.name) return entry.lens;
    known += (known.empty() ? "" : ", ") + std::string(entry.name);
  }
  throw InputError("unknown camera model '" + std::string(name) + "'; known: " + known);
}

const char* LensName(LensModel lens) { return Entry(lens).name; }
const char* LensParamNames(LensModel lens) { return Entry(lens).param_names; }
std::span<const LensExample> LensExamples(LensModel lens) { return Entry(lens).examples; }

}  // namespace gsut
