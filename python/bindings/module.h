// The binding functions, one a C++ folder, each defined in the file of that name.
#pragma once

#include <pybind11/pybind11.h>

namespace gsut::bindings {

void BindBase(pybind11::module_& m);
void BindCameras(pybind11::module_& m);
void BindPoses(pybind11::module_& m);
void BindStructure(pybind11::module_& m);
void BindMatching(pybind11::module_& m);
void BindGaussians(pybind11::module_& m);
void BindProjection(pybind11::module_& m);
void BindRaster(pybind11::module_& m);
void BindRasterBaseline(pybind11::module_& m);
void BindRefine(pybind11::module_& m);
void BindLoss(pybind11::module_& m);
void BindOptimize(pybind11::module_& m);
void BindCompact(pybind11::module_& m);
void BindFormats(pybind11::module_& m);

}  // namespace gsut::bindings
