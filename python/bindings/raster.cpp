// Binds gsut/raster.
#include <pybind11/pybind11.h>

#include "bindings/module.h"

namespace gsut::bindings {

void BindRaster(pybind11::module_&) {}

}  // namespace gsut::bindings
