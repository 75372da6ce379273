// The exceptions that gsut throws at the edge of its API, never inside a kernel or a parallel loop.
#pragma once

#include <stdexcept>
#include <string>

namespace gsut {

// An argument or an input file is wrong. The message says what, the value seen, and what to do.
// Python: gsut.InputError(ValueError).
class InputError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

// A lens file is wrong. The message names file, line and key. Python: gsut.CalibrationError.
class CalibrationError : public InputError {
 public:
  using InputError::InputError;
};

// A numerical solver failed; the message carries its summary.
// Python: gsut.SolveError(RuntimeError).
class SolveError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace gsut
