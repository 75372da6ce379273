"""Nobody but gsut.files opens, reads or writes a file; every reader is known and has an example."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MODULES = {  # module or class -> its functions that open files
    "np": {"load", "loadtxt", "fromfile", "genfromtxt", "save", "savez", "savez_compressed",
           "savetxt", "memmap"},
    "cv2": {"imread", "imwrite", "VideoCapture", "VideoWriter"},
    "os": {"open", "fdopen"},
    **{name: {"open"} for name in ("io", "av", "Image", "lzma", "bz2", "tarfile", "codecs")},
    **{name: {"load", "loads"} for name in ("json", "pickle", "tomllib")},
    "yaml": {"load", "safe_load", "load_all"}, "zipfile": {"ZipFile"}, "sqlite3": {"connect"},
    "shutil": {"copyfile", "copy", "copy2", "move"}, "rawpy": {"imread"},
    "ElementTree": {"parse"}, "mmap": {"mmap"}, "gzip": {"open", "decompress"},
}  # fmt: skip
METHODS = {"read_text", "read_bytes", "write_text", "write_bytes", "tofile"}
MODE = re.compile(r"[rwxa]b?\+?b?")
# What else opens files, and why.
ALLOWED = {
    "gsut/system.py": "flushes folders",
    "gsut/_on_demand.py": "reads the package's own source, before anything is imported",
    "gsut/output_folder.py": "holds the lock of a folder through an open file",
    "gsut/blocks/workers.py": "pipes between processes",
    "gsut/cli/__init__.py": "sends output nowhere",
    "gsut/render/films.py": "PyAV writes into a file of whole_file",
    "calib/solve/inside_mrcal.py": "runs in mrcal's Python, where gsut is not",
}


MOVING = ("gsut/formats/", "gsut/surface/mesh_files.py", "gsut/capture/")  # their turn is next


def find_openings(tree: ast.AST) -> list[tuple[int, str]]:
    """Finds calls that open a file: lines and what is called.

    A library may open what `check_regular` gives it in the same call.
    """
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or "check_regular(" in ast.unparse(node.args):
            continue
        function = node.func
        if isinstance(function, ast.Name):
            opens = function.id == "open"
        elif isinstance(function, ast.Attribute):
            owner = ast.unparse(function.value)
            opens = function.attr in MODULES.get(owner, ())
            opens |= function.attr in METHODS and len(node.args) < 2  # with two: of a RunFolder
            opens |= function.attr == "open" and any(
                isinstance(each, ast.Constant) and MODE.fullmatch(str(each.value))
                for each in (*node.args, *(k.value for k in node.keywords))
            )
        else:
            continue
        if opens:
            found.append((node.lineno, ast.unparse(function)))
    return found


def test_nobody_but_the_door_opens_files():
    checked = [*(ROOT / "python/gsut").rglob("*.py"), *(ROOT / "calib").rglob("*.py")]
    assert len(checked) > 300
    found, allowed = [], set()
    for path in checked:
        name = path.relative_to(ROOT).as_posix().removeprefix("python/")
        for line, call in find_openings(ast.parse(path.read_text("utf-8"))):
            if name in ALLOWED:
                allowed.add(name)
            elif not name.startswith(("gsut/files/", *MOVING)):
                found.append(f"{name}:{line} {call}")
    assert found == []
    assert allowed == set(ALLOWED)


@pytest.mark.parametrize(
    "line",
    ["open(path)", "path.open('rb')", "path.read_text('utf-8')", "np.load(path)", "json.loads(t)",
     "zipfile.ZipFile(path)", "Image.open(path)", "av.open(str(path), 'r')", "rawpy.imread(path)"],
)  # fmt: skip
def test_an_opening_is_found(line):
    assert len(find_openings(ast.parse(line))) == 1


def test_what_is_no_opening_passes():
    text = "av.open(check_regular(path)); run.write_text(name, text); RunFolder.open(path)"
    assert find_openings(ast.parse(text)) == []
