"""While the command line imports, Ctrl-C ends it at once and silently: nothing has begun.

An exception in the midst of an import would be a traceback, or another error of the library that is
being imported. A core that cannot be used is told in a sentence. A program that imports gsut keeps
its own way with signals and errors.
"""

import os
import signal
import sys
import threading
from pathlib import Path


def _is_command() -> bool:
    """Whether this process runs `gsut` or `python -m gsut`."""
    if sys.argv[:1] == ["-m"]:  # as long as Python looks for the module
        return sys.orig_argv[sys.orig_argv.index("-m") + 1 :][:1] == ["gsut"]
    return Path(sys.argv[0] if sys.argv else "").stem == "gsut"


def done() -> None:
    """From now on Ctrl-C raises KeyboardInterrupt again."""
    global _waits
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

if _is_command() and not os.environ.get("GSUT_DEBUG"):
    try:
        import gsut._core  # noqa: F401
    except ImportError as error:  # an unknown GSUT_ISA, or a library that is missing
        print(f"gsut: error: {error}", file=sys.stderr)
        sys.exit(2)
