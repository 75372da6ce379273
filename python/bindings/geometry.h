// Poses between numpy and the core.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include "gsut/geometry/pose.h"
#include "gsut/geometry/shutter.h"

namespace gsut::bindings {

// A 4x4 matrix, or an object with one in its attribute `matrix`.
Pose ReadPose(const pybind11::handle& object);
// A bound CameraMotion, or a pose as above: a camera that stands still.
CameraMotion ReadMotion(const pybind11::handle& object);
pybind11::array_t<double> WritePose(const Pose& pose);

}  // namespace gsut::bindings
