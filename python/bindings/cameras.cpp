// Binds gsut/cameras.
#include <pybind11/pybind11.h>

#include "bindings/module.h"

namespace gsut::bindings {

void BindCameras(pybind11::module_&) {}

}  // namespace gsut::bindings
