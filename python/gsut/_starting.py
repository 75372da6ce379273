"""While the command line imports, Ctrl-C ends it at once and silently: nothing has started.

An exception in the midst of an import would be a traceback, or another error of the library that is
being imported. What cannot be imported, for lack of memory for example, is reported
in one sentence. A program that imports gsut keeps its own handling of signals and errors.

A command lets numpy's linear algebra use one thread: with several, its sums are in another order,
and a result would depend on the number of processors. What is large has threads of gsut's own.
"""

import os
import signal
import sys
import threading
from pathlib import Path
from typing import Any


def _is_command() -> bool:
    """Returns whether this process runs `gsut` or `python -m gsut`."""
    if sys.argv[:1] == ["-m"]:  # as long as Python looks for the module
        return sys.orig_argv[sys.orig_argv.index("-m") + 1 :][:1] == ["gsut"]
    return Path(sys.argv[0] if sys.argv else "").stem == "gsut"


def finish_start() -> None:
    """Lets Ctrl-C raise KeyboardInterrupt again, and leaves errors to the command."""
    global _waits
    sys.excepthook = sys.__excepthook__
    if _waits:
        _waits = False
        signal.signal(signal.SIGINT, signal.default_int_handler)


_waits = (
    _is_command()
    and threading.current_thread() is threading.main_thread()
    and signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not where it is ignored
)
if _waits:
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _report_error(kind: type[BaseException], error: BaseException, trace: Any) -> None:
    """Ends the command at an unknown GSUT_ISA or a library that is missing or lacks memory."""
    if not isinstance(error, (ImportError, OSError, MemoryError)):
        return sys.__excepthook__(kind, error, trace)
    said = " ".join(str(error).split()) or "there is not enough memory to begin"
    print(f"gsut: error: {said}", file=sys.stderr)
    sys.exit(2)


# Numbers of threads of the libraries that numpy may be built with, read when they are loaded.
_BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

if _is_command():
    for _name in _BLAS_THREADS:
        os.environ.setdefault(_name, "1")
    os.environ.pop("MPLBACKEND", None)  # plots are files: no window, whatever the environment says
    if not os.environ.get("GSUT_DEBUG"):
        sys.excepthook = _report_error
    import gsut._core  # noqa: F401
