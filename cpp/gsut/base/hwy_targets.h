// Include before any Highway header: the instruction sets that gsut compiles its kernels for.
#pragma once

// Without any vectors, a processor of which no set is here or lab/run sanitize scalar, it is
// Highway's emulation of 128 bits in plain C++. Highway avoids it on GCC before 12.3 for a code
// generation bug;
// lab/run sanitize scalar runs every kernel on it.
#ifndef HWY_BROKEN_EMU128
#define HWY_BROKEN_EMU128 0
#endif

// A build for one set (GSUT_TARGETS) names it here as the least, and what is better than it.
#include "gsut_targets.h"
#ifndef GSUT_BETTER_TARGETS
#define GSUT_BETTER_TARGETS 0
#endif

// Kept: SSE4 (what CMakeLists.txt asks of every x86-64), AVX2, AVX-512 (HWY_AVX3), NEON. The others
// would double the build for no gain that we measured.
#define HWY_DISABLED_TARGETS                                                              \
  ((1LL << 4) | (1LL << 6) | HWY_AVX3_DL | HWY_SSSE3 | (1LL << 14) | HWY_SVE | HWY_SVE2 | \
   HWY_SVE_256 | HWY_SVE2_128 | GSUT_BETTER_TARGETS)
