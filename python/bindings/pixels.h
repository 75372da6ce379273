// Reads feature positions from Python.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "bindings/arrays.h"

namespace gsut::bindings {

inline std::vector<Eigen::Vector2d> ReadPixels(const py::handle& object) {
  const auto array = ReadArray<double>(object, "pixels", {kAny, 2});
  std::vector<Eigen::Vector2d> pixels(array.shape(0));
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    pixels[i] = {array.data()[2 * i], array.data()[2 * i + 1]};
  }
  return pixels;
}

}  // namespace gsut::bindings
