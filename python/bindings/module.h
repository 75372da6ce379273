// The binding functions, one or a few a C++ folder, each defined in the file of that name.
#pragma once

#include <pybind11/pybind11.h>

namespace gsut::bindings {

void BindArrays(pybind11::module_& m);
void BindBase(pybind11::module_& m);
void BindGeometry(pybind11::module_& m);
void BindCameras(pybind11::module_& m);
void BindGaussians(pybind11::module_& m);
void BindProjection(pybind11::module_& m);
void BindRaster(pybind11::module_& m);
void BindRasterReference(pybind11::module_& m);
void BindSurroundings(pybind11::module_& m);
void BindLoss(pybind11::module_& m);
void BindLossPixels(pybind11::module_& m);
void BindOptimize(pybind11::module_& m);
void BindOptimizeCompact(pybind11::module_& m);
void BindSfmMatching(pybind11::module_& m);
void BindSfmStructure(pybind11::module_& m);
void BindSfmPhotometric(pybind11::module_& m);
void BindSurface(pybind11::module_& m);
void BindStereo(pybind11::module_& m);
void BindFormats(pybind11::module_& m);

}  // namespace gsut::bindings
