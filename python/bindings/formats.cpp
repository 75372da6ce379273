// Binds gsut/formats.
#include <pybind11/pybind11.h>

#include "bindings/module.h"

namespace gsut::bindings {

void BindFormats(pybind11::module_&) {}

}  // namespace gsut::bindings
