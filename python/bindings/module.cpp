// The Python module gsut._core: exceptions, then one function a C++ folder.
#include <pybind11/pybind11.h>

#include <cstring>
#include <exception>
#include <utility>

#include "bindings/module.h"
#include "gsut/base/errors.h"
#include "gsut/base/isa.h"

namespace {

// Raises with a message whose bytes need not be UTF-8, as those of a file's name.
void Raise(const pybind11::handle& type, const char* message) {
  const auto text = pybind11::reinterpret_steal<pybind11::object>(PyUnicode_DecodeUTF8(
      message, static_cast<Py_ssize_t>(std::strlen(message)), "surrogateescape"));
  if (text) PyErr_SetObject(type.ptr(), text.ptr());
}

pybind11::dict DescribeBuild() {
  pybind11::dict facts;
  facts["version"] = GSUT_VERSION;
  const std::pair<const char*, const char*> found[] = {
#include "build_facts.inc"
  };
  for (const auto& [name, value] : found) facts[name] = value;
  return facts;
}

}  // namespace

// One module for all of the core: exceptions first, as everything else may raise them, then a
// function a C++ folder. Bindings check shapes and dtypes, release the GIL and convert; they hold
// no maths, and the names here are private: the package wraps them in ones with docstrings.
PYBIND11_MODULE(_core, m) {
  using namespace gsut::bindings;  // NOLINT: the list below reads better without prefixes
  if (gsut::AvailableIsas().empty()) {
    throw pybind11::import_error(
        "this gsut was compiled for processors with " + gsut::CompiledIsas().back() +
        ", and this one lacks it; compile it here: delete build/ and run ./run setup, or set "
        "GSUT_TARGETS=all for CMake, which needs SSE4.2, as all x86-64 since 2011 have");
  }
  m.doc() = "C++ core of gsut; use the names of the gsut package.";
  m.attr("__version__") = GSUT_VERSION;
  m.def("describe_build", &DescribeBuild, R"doc(
Returns how the compiled core was built.

Returns:
    dict of str: version, compiler, build_type, system, and the versions of the libraries that it
    was compiled with: eigen, highway, threads (tbb or plain), ceres, pybind11.
)doc");
  static const auto input_error =
      pybind11::register_exception<gsut::InputError>(m, "InputError", PyExc_ValueError);
  static const auto calibration_error = pybind11::register_exception<gsut::CalibrationError>(
      m, "CalibrationError", input_error.ptr());
  static const auto solve_error =
      pybind11::register_exception<gsut::SolveError>(m, "SolveError", PyExc_RuntimeError);
  // Messages may hold a file's name, whose bytes need not be UTF-8: pybind11's own translation
  // would fail on them. The most derived class is caught first.
  pybind11::register_exception_translator([](std::exception_ptr error) {  // asked before these
    try {
      if (error) std::rethrow_exception(error);
    } catch (const gsut::CalibrationError& raised) {
      Raise(calibration_error, raised.what());
    } catch (const gsut::InputError& raised) {
      Raise(input_error, raised.what());
    } catch (const gsut::SolveError& raised) {
      Raise(solve_error, raised.what());
    }
  });
  // pybind11 makes exception classes without docstrings; users read these in help().
  input_error.attr("__doc__") =
      "An argument, option or dataset is wrong; the message says which, what was found, what to "
      "do.";
  calibration_error.attr("__doc__") =
      "A lens file cannot be used; the message names file, line where known, and key.";
  solve_error.attr("__doc__") = "A solver found nothing; the message carries its summary.";
  gsut::ActiveIsa();  // applies GSUT_ISA now, so that an unknown name fails at import
  // A class must be bound before a function takes it as an argument with a default.
  BindArrays(m);
  BindBase(m);
  BindCameras(m);
  BindGeometry(m);
  BindGaussians(m);
  BindProjection(m);
  BindOptimize(m);  // before what takes its steps
  BindRaster(m);
  BindRasterReference(m);
  BindSurroundings(m);
  BindLoss(m);
  BindLossPixels(m);
  BindOptimizeCompact(m);
  BindSfmMatching(m);
  BindSfmStructure(m);
  BindSfmPhotometric(m);
  BindSurface(m);
  BindStereo(m);
  BindFormats(m);
}
