"""The one rule for folders that a command writes: new, empty, or made by the same command before.

Nothing that somebody else put there is ever replaced, and two processes never write one folder.
"""

from __future__ import annotations

import json
import os
import stat
import threading
import weakref
from collections.abc import Collection
from pathlib import Path

from gsut import _core
from gsut._core import InputError
from gsut.files import UNFINISHED, FileError, check_name, read_json, remove_unfinished

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]
    import msvcrt

MARKER = "gsut.json"  # in the folder: which command wrote it, of what, and the lock
_LITTER = frozenset((MARKER, ".DS_Store", "Thumbs.db", "desktop.ini"))  # no content of anybody's
_LOCKED_BYTE = (
    1 << 30
)  # on Windows, where a locked byte cannot be read: far beyond the marker's end
_claims: weakref.WeakValueDictionary[Path, OutputFolder] = weakref.WeakValueDictionary()
_claiming = threading.Lock()


class OutputFolder:
    """A folder that this process alone writes, to the end of the outermost `with` or, without one,
    as long as this object lives: see `claim_folder`.

    The lock is the system's and ends with the process, however that ends. Where nothing was written
    the marker goes at the end, and the folder if it was made for this.

    Attributes:
        path: the folder.
    """

    def __init__(
        self, marker: Path, descriptor: int, made: bool, writes: Collection[str] | None
    ) -> None:
        self.path = marker.parent
        self._marker, self._descriptor = marker, descriptor
        self._depth = 0
        self._let_go = weakref.finalize(self, _let_go, marker, descriptor, made, writes)

    def __enter__(self) -> OutputFolder:
        self._depth += 1
        return self

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if not self._depth:
            self._let_go()

    def is_held(self) -> bool:
        """Returns whether the claim still holds and nobody has removed or replaced the folder."""
        try:
            found = os.stat(self._marker)
            return self._let_go.alive and os.path.samestat(found, os.fstat(self._descriptor))
        except OSError:
            return False


def claim_folder(
    path: str | os.PathLike[str],
    command: str,
    source: str | os.PathLike[str] | None = None,
    *,
    writes: Collection[str] | None = None,
) -> OutputFolder:
    """Takes a folder to write to; it and its parents are made where absent.

    Args:
        path: the folder.
        command: whose folder it becomes, such as "train".
        source: what the folder is made of, for its marker.
        writes: names of what will be written, in a folder that may hold other things; its marker
            is gsut-COMMAND.json. None: the folder is the command's own.

    Returns:
        The folder; keep the object as long as the folder is written. What this process holds
        already is not asked again: a stage of a command writes where the command does.

    Raises:
        InputError: it has no name, is a file, cannot be made or written, holds what this command
            did not write, or another process is writing there. Nothing was changed then.
    """
    if not os.fspath(path):
        raise InputError("the folder to write to has no name; give one, such as run")
    check_name(path)
    folder = Path(path)
    with _claiming:
        marker = folder / (MARKER if writes is None else f"gsut-{command}.json")
        held = _claims.get(marker.resolve())
        if held is None or not held.is_held():
            held = _claim(marker, command, source, writes)
            _claims[marker.resolve()] = held
    return held


def is_claimed(path: str | os.PathLike[str]) -> bool:
    """Returns whether a command of gsut writes to the folder, or has written there."""
    return (Path(path) / MARKER).is_file()


def _claim(
    marker: Path,
    command: str,
    source: str | os.PathLike[str] | None,
    writes: Collection[str] | None,
) -> OutputFolder:
    folder = marker.parent
    _refuse_foreign(marker, command, writes)
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.path.lexists(marker) and not stat.S_ISREG(marker.lstat().st_mode):
            raise InputError(f"{marker} is not a file of gsut; remove it, or name another folder")
        descriptor = os.open(marker, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise InputError(
            f"cannot make the folder {folder}: {error.strerror}; name a writable one"
        ) from None
    try:
        _lock(folder, descriptor)
        if _read_owner(marker) != f"gsut {command}":  # new, or torn by a crash
            content = {
                "command": f"gsut {command}",
                "version": _core.__version__,
                "input": None if source is None else os.path.realpath(source),
            }
            with open(os.dup(descriptor), "w", encoding="utf-8", errors="backslashreplace") as file:
                file.truncate()
                file.write(json.dumps(content, indent=2) + "\n")
        remove_unfinished(folder, of_all=writes is None)
    except OSError as error:
        _let_go(marker, descriptor, made, writes)
        raise InputError(f"cannot write {marker}: {error.strerror}") from None
    except InputError:
        os.close(descriptor)
        raise
    return OutputFolder(marker, descriptor, made, writes)


def _refuse_foreign(marker: Path, command: str, writes: Collection[str] | None) -> None:
    """Raises InputError if the folder holds what this command did not write."""
    folder = marker.parent
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise InputError(f"{folder} is a file; give a folder to write to")
    found = _list_found(folder, writes)
    if not found:
        return
    mine = f"gsut {command}"
    owner = _read_owner(marker) if marker.is_file() else "something other than gsut"
    if owner not in (None, mine):
        some = ", ".join(sorted(found)[:3]) + (" ..." if len(found) > 3 else "")
        raise InputError(
            f"{folder} holds files that {owner} wrote ({some}); give {mine} a new or an empty "
            "folder (nothing was overwritten)"
        )


def _list_found(folder: Path, writes: Collection[str] | None) -> set[str]:
    """Lists what lies where the command would write."""
    names = set(os.listdir(folder))
    found = names - _LITTER if writes is None else names & set(writes)
    return {name for name in found if not name.startswith(UNFINISHED)}


def _read_owner(marker: Path) -> str | None:
    """Returns the command that the marker names; None if a crash tore it."""
    try:
        command: str = read_json(marker, {"command": str})["command"]
        return command
    except FileError:
        return None


def _lock(folder: Path, descriptor: int) -> None:
    """Raises InputError if another process has the folder."""
    try:
        if fcntl is not None:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        else:
            os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
            os.lseek(descriptor, 0, os.SEEK_SET)
    except (BlockingIOError, PermissionError):  # PermissionError: Windows
        raise InputError(
            f"another gsut is writing {folder}; wait until it ends, or give another folder"
        ) from None
    except OSError:
        pass  # a file system without locks


def _let_go(marker: Path, descriptor: int, made: bool, writes: Collection[str] | None) -> None:
    try:
        if not _list_found(marker.parent, writes):
            marker.unlink()
            if made:
                marker.parent.rmdir()
    except OSError:
        pass  # it is somebody else's now, or gone
    finally:
        os.close(descriptor)
