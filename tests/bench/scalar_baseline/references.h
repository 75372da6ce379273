// Binds what only tests call.
#pragma once

#include <pybind11/pybind11.h>

namespace gsut::bindings {

void BindReferences(pybind11::module_& m);

}  // namespace gsut::bindings
