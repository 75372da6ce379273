"""Lists the sources of the WebAssembly module, each with a hash of its code.

    ninja -t deps | python lab/list_wasm_sources.py BUILD_LOG

Only the sources of linked objects count, and their comments do not.
"""

import hashlib
import re
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_COMMENT = re.compile(r"//[^\n]*")
_HASH_DIGITS = 12
# What the build adds beside what the compiler reports.
_BUILD = ("cpp/wasm/CMakeLists.txt",)


def hash_code(text: str) -> str:
    """Hashes a source without its comments and white space."""
    code = "".join(_COMMENT.sub("", text).split())
    return hashlib.sha256(code.encode()).hexdigest()[:_HASH_DIGITS]


def find_sources(dependencies: Iterable[str], log: str) -> set[str]:
    """Finds the sources below cpp/ of the objects that the linker used.

    Args:
        dependencies: lines of `ninja -t deps`: an object, then its sources, indented.
        log: of the build, in which the linker names the objects.
    """
    traced = "\n".join(line for line in log.splitlines() if "Building CXX object" not in line)
    linked = set(re.findall(r"(?<![\w.])[\w.]+\.cpp\.o", traced))
    found, wanted = set(), False
    for line in dependencies:
        if line[:1].strip():
            wanted = Path(line.split(":")[0]).name in linked
        elif wanted and line.strip():
            path = (ROOT / "build-wasm" / line.strip()).resolve()
            if path.is_relative_to(ROOT / "cpp"):
                found.add(str(path.relative_to(ROOT)))
    return found


if __name__ == "__main__":
    sources = find_sources(
        sys.stdin, Path(sys.argv[1]).read_text(encoding="utf-8", errors="replace")
    )
    for name in sorted(sources | set(_BUILD)):
        print(hash_code((ROOT / name).read_text(encoding="utf-8")), name)
