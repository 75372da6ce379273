// Binds gsut/optimize.
#include <pybind11/pybind11.h>

#include "bindings/module.h"

namespace gsut::bindings {

void BindOptimize(pybind11::module_&) {}

}  // namespace gsut::bindings
