// Binds gsut/base: threads and instruction sets.
//
// Threads and instruction set may be changed at any time between two calls.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "bindings/module.h"
#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"

namespace gsut::bindings {
// Settings of the whole process, read by the core at its next parallel loop or kernel. Forcing an
// instruction set is for tests and timings: each gives the same image within rounding.
void BindBase(pybind11::module_& m) {
  m.def("set_num_threads", &SetNumThreads, pybind11::arg("num_threads"),
        R"doc(
Sets the number of threads of all parallel loops. Results do not depend on it.

Args:
    num_threads: at least 1; 0: all processors.

Raises:
    InputError: a negative number.
)doc");
  m.def("num_threads", &NumThreads, R"doc(
The number of threads of all parallel loops.

Returns:
    int, at least 1.
)doc");
  // Names are Highway's targets; what a build has depends on the compiler and the processor.
  m.def("active_isa", &ActiveIsa, R"doc(
Name of the vector instruction set in use.

Returns:
    One of `available_isas()`, such as "AVX3_SPR", "AVX2" or "NEON".
)doc");
  m.def("available_isas", &AvailableIsas, R"doc(
The vector instruction sets that this build has and this processor offers.

Returns:
    Names, the best first; the last is plain C++.
)doc");
  m.def("set_isa", &SetIsa, pybind11::arg("name"), R"doc(
Forces a vector instruction set, as the environment variable GSUT_ISA does at import.

Args:
    name: one of `available_isas()`; empty: back to the best one.

Raises:
    InputError: an unknown name; the known ones are listed.
)doc");
}

}  // namespace gsut::bindings
