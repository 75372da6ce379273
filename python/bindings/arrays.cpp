// Reads arrays of other libraries (torch, jax, cupy) through the protocols that they share.
#include "bindings/arrays.h"

#include "bindings/module.h"

namespace gsut::bindings {
namespace {

// Devices of DLPack whose memory the processor reads: main memory, also as pinned for CUDA and
// ROCm.
constexpr int kReadableDevices[] = {1, 3, 11};

bool Has(const py::handle& object, const char* attribute) { return py::hasattr(object, attribute); }

// Throws InputError if the array lies in memory that the processor cannot read.
void RequireMainMemory(const py::handle& object, const char* name) {
  if (!Has(object, "__dlpack_device__")) return;
  int device = kReadableDevices[0];
  try {
    device = py::cast<int>(py::tuple(object.attr("__dlpack_device__")())[0]);
  } catch (const py::error_already_set&) {
    return;  // as where gradients are recorded; what comes next says more
  }
  for (const int readable : kReadableDevices) {
    if (device == readable) return;
  }
  throw InputError(std::string(name) + " is on a device (DLPack's type " + std::to_string(device) +
                   "; 2 is a CUDA GPU): copy it to main memory first, as by .cpu() or .get()");
}

// The first line of an error of Python, with its type.
std::string Describe(const py::error_already_set& error) {
  std::string text = py::cast<std::string>(py::str(error.value()));
  text.resize(std::min(text.find('\n'), text.size()));
  return py::cast<std::string>(error.type().attr("__name__")) + ": " + text;
}

py::object Convert(const py::handle& object, const char* name) {
  const py::module_ numpy = py::module_::import("numpy");
  const bool only_dlpack =
      Has(object, "__dlpack__") && !Has(object, "__array__") && !PyObject_CheckBuffer(object.ptr());
  try {
    return numpy.attr(only_dlpack ? "from_dlpack" : "asarray")(object);
  } catch (const py::error_already_set& error) {
    if (error.matches(PyExc_MemoryError)) throw;
    const std::string type = py::cast<std::string>(error.type().attr("__name__"));
    if (type.rfind("Tracer", 0) == 0) {
      throw InputError(std::string(name) + " is traced by JAX and has no values yet: call gsut " +
                       "through jax.pure_callback, as docs/jax.md shows");
    }
    throw InputError(std::string(name) + " cannot be read as an array of numbers (" +
                     Describe(error) + "); give a numpy array, or what numpy.asarray takes");
  }
}

}  // namespace

py::array ToNumpy(const py::handle& object, const char* name) {
  py::object found = py::reinterpret_borrow<py::object>(object);
  if (!py::isinstance<py::array>(object)) {
    RequireMainMemory(object, name);
    if (Has(object, "requires_grad") && py::cast<bool>(object.attr("requires_grad"))) {
      throw InputError(std::string(name) + " records gradients: give its values, as by .detach()");
    }
    found = Convert(object, name);
  }
  py::array array = py::reinterpret_borrow<py::array>(found);
  const char kind = array.dtype().kind();
  if (std::string("biuf").find(kind) == std::string::npos) {
    throw InputError(std::string(name) + " is not an array of numbers, found dtype " +
                     py::cast<std::string>(py::str(array.dtype())) +
                     (kind == 'V' || kind == 'c' ? "; convert it to float32" : ""));
  }
  return array;
}

void BindArrays(py::module_& m) {
  m.def(
      "read_array",
      [](const py::object& object, const std::string& name) {
        return ToNumpy(object, name.c_str());
      },
      py::arg("object"), py::arg("name"));
}

}  // namespace gsut::bindings
