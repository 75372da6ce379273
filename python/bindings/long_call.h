// Calls that release the GIL and may take long.
#pragma once

#include <pybind11/pybind11.h>

#include <exception>

#include "gsut/base/interrupt.h"

namespace gsut::bindings {

// Releases the GIL, and ends the call where a signal's handler raises, as Ctrl-C's does. Not for a
// function that changes its arguments in place: half of that would stay.
class LongCall {
 public:
  LongCall() : check_(&Raised) {}

 private:
  static std::exception_ptr Raised() {
    const pybind11::gil_scoped_acquire acquired;
    if (PyErr_CheckSignals() == 0) return nullptr;
    return std::make_exception_ptr(pybind11::error_already_set());
  }

  pybind11::gil_scoped_release released_;
  InterruptCheck check_;
};

}  // namespace gsut::bindings
