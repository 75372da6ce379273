// Binds gsut/loss.
#include <pybind11/pybind11.h>

#include "bindings/module.h"

namespace gsut::bindings {

void BindLoss(pybind11::module_&) {}

}  // namespace gsut::bindings
