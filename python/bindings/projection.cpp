// Binds gsut/projection.
#include <pybind11/pybind11.h>

#include "bindings/module.h"

namespace gsut::bindings {

void BindProjection(pybind11::module_&) {}

}  // namespace gsut::bindings
