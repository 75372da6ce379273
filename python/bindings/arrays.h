// Shape and dtype checks between numpy arrays and the core's views.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <cstdint>
#include <initializer_list>
#include <string>
#include <vector>

#include "gsut/base/errors.h"
#include "gsut/gaussians/gaussians.h"

namespace gsut::bindings {

namespace py = pybind11;

// -1 in an expected shape stands for any length.
inline constexpr std::int64_t kAny = -1;

inline std::string ShapeText(const py::array& array) {
  std::string text = "(";
  for (py::ssize_t i = 0; i < array.ndim(); ++i) text += std::to_string(array.shape(i)) + ",";
  return text + ")";
}

// Throws InputError unless the array has the expected shape.
inline void CheckShape(const py::array& array, const char* name,
                       std::initializer_list<std::int64_t> expected) {
  bool same = array.ndim() == static_cast<py::ssize_t>(expected.size());
  std::string wanted = "(";
  py::ssize_t axis = 0;
  for (const std::int64_t length : expected) {
    wanted += (length == kAny ? std::string("any") : std::to_string(length)) + ",";
    if (same && length != kAny && array.shape(axis) != length) same = false;
    ++axis;
  }
  if (!same) {
    throw InputError(std::string(name) + " must have shape " + wanted + "), found " +
                     ShapeText(array));
  }
}

// The object as a numpy array of numbers: itself if it is one; without a copy what lies in main
// memory behind __array__, a buffer or __dlpack__; else, as a list does, by a copy.
// Throws InputError, which names the cure, where it lies on a device, records gradients or holds
// what numpy does not compute with.
py::array ToNumpy(const py::handle& object, const char* name);

// The array as C-contiguous T of the expected shape, converted if needed (reading only).
template <class T>
py::array_t<T, py::array::c_style | py::array::forcecast> ReadArray(
    const py::handle& object, const char* name, std::initializer_list<std::int64_t> expected) {
  using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;
  Array array = Array::ensure(ToNumpy(object, name));
  if (!array) {
    PyErr_Clear();
    throw InputError(std::string(name) + " is not an array of numbers");
  }
  CheckShape(array, name, expected);
  return array;
}

// Pointer to an array that must already be T, C-contiguous and of this shape: never copied.
template <class T>
const T* ConstData(const py::handle& object, const char* name,
                   std::initializer_list<std::int64_t> expected) {
  using Array = py::array_t<T, py::array::c_style>;
  if (!py::isinstance<Array>(object)) {
    throw InputError(std::string(name) + " must be a C-contiguous numpy array of dtype " +
                     std::string(py::str(py::dtype::of<T>())));
  }
  const py::array array = py::reinterpret_borrow<py::array>(object);
  CheckShape(array, name, expected);
  return static_cast<const T*>(array.data());
}

// As ConstData; None is null.
template <class T>
const T* OptionalData(const py::object& array, const char* name,
                      std::initializer_list<std::int64_t> shape) {
  return array.is_none() ? nullptr : ConstData<T>(array, name, shape);
}

// As ConstData, and writable: the core changes it in place.
template <class T>
T* MutableData(const py::handle& object, const char* name,
               std::initializer_list<std::int64_t> expected) {
  const T* data = ConstData<T>(object, name, expected);
  if (!py::reinterpret_borrow<py::array>(object).writeable()) {
    throw InputError(std::string(name) + " must be writable");
  }
  return const_cast<T*>(data);
}

// View of a gsut.Gaussians (any object with means, quats, log_scales, opacity_logits, sh as
// C-contiguous arrays) or of a gsut.LinearGaussians, which has scales and opacities instead. View
// is GaussiansView<T>, or GaussiansView<const T> to read only, and get(object, name, shape) the
// checked pointer. The caller keeps the object alive as long as the view.
template <class View, class Get>
View GaussiansOf(const py::handle& gaussians, Get&& get) {
  View view;
  const py::object sh = gaussians.attr("sh");
  const py::object means = gaussians.attr("means");
  view.size = static_cast<std::int64_t>(py::len(means));
  view.means = get(means, "means", {view.size, 3});
  view.quats = get(gaussians.attr("quats"), "quats", {view.size, 4});
  view.is_linear = py::hasattr(gaussians, "opacities");
  const char* scales = view.is_linear ? "scales" : "log_scales";
  const char* opacities = view.is_linear ? "opacities" : "opacity_logits";
  view.log_scales = get(gaussians.attr(scales), scales, {view.size, 3});
  view.opacity_logits = get(gaussians.attr(opacities), opacities, {view.size});
  const auto sh_array = py::reinterpret_borrow<py::array>(sh);
  view.sh_coefficients = sh_array.ndim() == 3 ? static_cast<int>(sh_array.shape(1)) : 0;
  view.sh = get(sh, "sh", {view.size, view.sh_coefficients, 3});
  // What a model carries of its rule; arrays without it are drawn by the maximum and the distance.
  if (py::hasattr(gaussians, "response")) {
    view.response = ResponseNamed(py::cast<std::string>(gaussians.attr("response")));
  }
  if (py::hasattr(gaussians, "order")) {
    view.order = OrderNamed(py::cast<std::string>(gaussians.attr("order")));
  }
  if (py::hasattr(gaussians, "primitive")) {
    view.primitive = PrimitiveNamed(py::cast<std::string>(gaussians.attr("primitive")));
  }
  const int k = view.sh_coefficients;
  if (k != 1 && k != 4 && k != 9 && k != 16) {
    throw InputError("sh must have 1, 4, 9 or 16 coefficients (degree 0 to 3), found " +
                     std::to_string(k));
  }
  return view;
}

template <class T>
GaussiansView<T> MutableGaussians(const py::handle& gaussians) {
  return GaussiansOf<GaussiansView<T>>(gaussians, [](const py::handle& array, const char* name,
                                                     std::initializer_list<std::int64_t> shape) {
    return MutableData<T>(array, name, shape);
  });
}

template <class T>
GaussiansView<const T> ConstGaussians(const py::handle& gaussians) {
  return GaussiansOf<GaussiansView<const T>>(
      gaussians,
      [](const py::handle& array, const char* name, std::initializer_list<std::int64_t> shape) {
        return ConstData<T>(array, name, shape);
      });
}

// Reads a dictionary of settings into the fields of options.
class SettingsReader {
 public:
  SettingsReader(const py::dict& values, const char* function)
      : values_(values), function_(function) {}

  // Leaves the field as it is where there is no such setting.
  template <class T>
  void Read(const char* name, T* field) {
    known_.emplace_back(name);
    if (!values_.contains(name)) return;
    try {
      *field = py::cast<T>(values_[name]);
    } catch (const py::cast_error&) {
      throw InputError(std::string(function_) + ": " + name + " is of a wrong type");
    }
  }

  // Throws InputError for a setting that was neither read nor is among `others`.
  void CheckAllRead(std::initializer_list<const char*> others = {}) {
    known_.insert(known_.end(), others.begin(), others.end());
    for (const auto& [key, value] : values_) {
      const auto name = py::cast<std::string>(key);
      if (std::find(known_.begin(), known_.end(), name) != known_.end()) continue;
      throw InputError(std::string(function_) + " has no setting " + name);
    }
  }

 private:
  py::dict values_;
  const char* function_;
  std::vector<std::string> known_;
};

// A new uninitialised array.
template <class T>
py::array_t<T> NewArray(std::initializer_list<py::ssize_t> shape) {
  return py::array_t<T>(std::vector<py::ssize_t>(shape));
}

}  // namespace gsut::bindings
