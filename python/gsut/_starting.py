"""While the command line imports, Ctrl-C ends it at once with one line: nothing has started.

An exception in the midst of an import would be a traceback, or another error of the library that is
being imported. What cannot be imported, for lack of memory for example, is reported
in one sentence. A program that imports gsut keeps its own handling of signals and errors.

A command lets numpy's linear algebra use one thread: with several, its sums are in another order,
and a result would depend on the number of processors. What is large has threads of gsut's own.
"""

from __future__ import annotations

# Built in: importing `signal` takes long enough to be interrupted.
import _signal  # type: ignore[import-not-found]
import os
import sys

TYPE_CHECKING = False  # as in `typing`, which takes long to import too
if TYPE_CHECKING:
    from types import TracebackType

EXIT_INTERRUPTED = 130  # as shells report Ctrl-C


def _is_command() -> bool:
    """Returns whether this process runs `gsut` or `python -m gsut`."""
    if sys.argv[:1] == ["-m"]:  # as long as Python looks for the module
        return sys.orig_argv[sys.orig_argv.index("-m") + 1 :][:1] == ["gsut"]
    name = os.path.basename(sys.argv[0] if sys.argv else "")
    return os.path.splitext(name)[0] == "gsut"


def _end_command(*_: object) -> None:
    """Ends the process without an exception, which an import could turn into another."""
    os.write(2, b"gsut: interrupted; nothing was started\n")
    os._exit(EXIT_INTERRUPTED)


def _wait_for_start() -> bool:
    """Lets Ctrl-C end the command; returns False where it is no command or Ctrl-C is ignored."""
    if not _is_command() or _signal.getsignal(_signal.SIGINT) is not _signal.default_int_handler:
        return False
    try:
        _signal.signal(_signal.SIGINT, _end_command)
    except ValueError:  # not the main thread
        return False
    return True


_waits = _wait_for_start()


def finish_start() -> None:
    """Lets Ctrl-C raise KeyboardInterrupt again, and leaves errors to the command."""
    global _waits
    sys.excepthook = sys.__excepthook__
    if _waits:
        _waits = False
        _signal.signal(_signal.SIGINT, _signal.default_int_handler)


def _report_error(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
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
