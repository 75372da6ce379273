// Binds gsut/gaussians.
#include <pybind11/pybind11.h>

#include "bindings/module.h"

namespace gsut::bindings {

void BindGaussians(pybind11::module_&) {}

}  // namespace gsut::bindings
