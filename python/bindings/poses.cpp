// Binds gsut/poses.
#include <pybind11/pybind11.h>

#include "bindings/module.h"

namespace gsut::bindings {

void BindPoses(pybind11::module_&) {}

}  // namespace gsut::bindings
