"""What a folder holds, to tell whether a command changed it."""

import hashlib
import os
import stat
from pathlib import Path


def take_snapshot(folder: Path) -> dict[str, str]:
    """Lists all names below a folder, with kind and a digest of the content."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = os.fsencode(path.relative_to(folder)).decode("utf-8", "backslashreplace")
        mode = path.lstat().st_mode
        if stat.S_ISLNK(mode):
            found[name] = f"link to {os.readlink(path)}"
        elif stat.S_ISDIR(mode):
            found[name] = "folder"
        elif stat.S_ISREG(mode):
            found[name] = hashlib.sha1(path.read_bytes()).hexdigest()
        else:
            found[name] = "other"
    return found
