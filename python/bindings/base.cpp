// Binds gsut/base: threads and instruction sets.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "bindings/module.h"
#include "gsut/base/isa.h"
#include "gsut/base/parallel.h"

namespace gsut::bindings {

void BindBase(pybind11::module_& m) {
  m.def("set_num_threads", &SetNumThreads, pybind11::arg("num_threads"),
        "Sets the number of threads of all parallel loops; 0 means all processors.");
  m.def("num_threads", &NumThreads, "The number of threads of all parallel loops.");
  m.def("active_isa", &ActiveIsa, "Name of the vector instruction set in use.");
  m.def("available_isas", &AvailableIsas, "Instruction sets this build and processor offer.");
  m.def("set_isa", &SetIsa, pybind11::arg("name"),
        "Forces an instruction set by name; an empty name goes back to the best one.");
}

}  // namespace gsut::bindings
