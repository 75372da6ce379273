// Which vector instruction set the kernels run on, and how to force one (environment GSUT_ISA).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace gsut {

// Names of the instruction sets this build has kernels for and this processor can run, best first:
// among "avx512", "avx2", "sse4", "neon", "wasm", "scalar".
std::vector<std::string> AvailableIsas();

// Those this build has kernels for, best first, whatever the processor is; see GSUT_TARGETS in
// CMakeLists.txt.
std::vector<std::string> CompiledIsas();

// The one in use: the best available, or the one named by GSUT_ISA or SetIsa.
std::string ActiveIsa();

// Forces one by name; an empty name goes back to the best. Throws InputError listing the names.
void SetIsa(const std::string& name);

}  // namespace gsut
