// Choice of the vector instruction set, on top of Highway's dynamic dispatch.
#include "gsut/base/isa.h"

#include "gsut/base/hwy_targets.h"

#include <hwy/highway.h>
#include <hwy/targets.h>

#include <cstdlib>

#include "gsut/base/errors.h"

namespace gsut {
namespace {

struct IsaName {
  const char* name;
  std::int64_t targets;
};

// Best first.
constexpr IsaName kIsaNames[] = {
    {"avx512", HWY_AVX3}, {"avx2", HWY_AVX2}, {"sse4", HWY_SSE4},
    {"neon", HWY_NEON},   {"wasm", HWY_WASM}, {"scalar", HWY_EMU128 | HWY_SCALAR},
};

#if HWY_ARCH_WASM
// Compiled for one target, without Highway's detection and its tables.
std::int64_t UsableTargets() { return HWY_TARGETS; }
// There is nothing to choose: SetIsa has refused every other name.
void Force(std::int64_t) {}
#else
// Targets compiled in and supported by the processor, before any forcing.
std::int64_t UsableTargets() {
  // The fallback needs no support; Highway's library may know it under its other name.
  static const std::int64_t targets =
      (hwy::SupportedTargets() | HWY_EMU128 | HWY_SCALAR) & HWY_TARGETS;
  return targets;
}

// Highway's dispatch tables look at these targets from the next call on; 0 restores detection.
void Force(std::int64_t targets) {
  hwy::SetSupportedTargetsForTest(targets);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}
#endif

// Applies GSUT_ISA the first time anybody asks.
void ApplyEnvironmentOnce() {
  // UsableTargets must be known before forcing changes what Highway reports.
  static const bool applied = [] {
    UsableTargets();
    const char* name = std::getenv("GSUT_ISA");
    if (name != nullptr && *name != '\0') SetIsa(name);
    return true;
  }();
  static_cast<void>(applied);
}

// A name may stand for several of Highway's targets, of which one is compiled in.
std::vector<std::string> NamesOf(std::int64_t targets) {
  std::vector<std::string> names;
  for (const IsaName& isa : kIsaNames) {
    if (targets & isa.targets) names.emplace_back(isa.name);
  }
  return names;
}

std::string& ForcedName() {
  static std::string name;
  return name;
}

}  // namespace

std::vector<std::string> AvailableIsas() { return NamesOf(UsableTargets()); }

std::vector<std::string> CompiledIsas() { return NamesOf(HWY_TARGETS); }

std::string ActiveIsa() {
  ApplyEnvironmentOnce();
  return ForcedName().empty() ? AvailableIsas().front() : ForcedName();
}

void SetIsa(const std::string& name) {
  const std::int64_t usable = UsableTargets();
  if (name.empty()) {
    Force(0);
    ForcedName().clear();
    return;
  }
  std::string known;
  for (const IsaName& isa : kIsaNames) {
    // Sets that this processor lacks are not offered.
    if ((usable & isa.targets) == 0) continue;
    if (name == isa.name) {
      Force(usable & isa.targets);
      ForcedName() = name;
      return;
    }
    known += std::string(known.empty() ? "" : ", ") + isa.name;
  }
  // Better an error than a test that silently runs another set.
  throw InputError("instruction set \"" + name +
                   "\" (GSUT_ISA) is unknown or not available here; " +
                   "this build and processor offer: " + known);
}

}  // namespace gsut
