"""The floors of the Python side: a folder imports doors of lower floors only."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# Folder (or module) of python/gsut -> floor; the package `gsut` itself is above all.
FLOORS = {
    "_core": -2,
    "_starting": -1,
    **dict.fromkeys(("files", "least_squares"), 0),  # what folders of floor 1 share
    "output_folder": 0.5,  # above `files`
    **dict.fromkeys(("gaussians", "lens", "run", "page"), 1),
    **dict.fromkeys(("render", "optimize", "data", "formats"), 2),
    **dict.fromkeys(("capture", "sfm", "evaluate", "compact", "surface"), 3),
    **dict.fromkeys(("refine", "check", "demo"), 4),
    "training": 5,
    **dict.fromkeys(("train", "blocks", "view"), 6),
    **dict.fromkeys(("__init__", "torch"), 7),
    "cli": 8,
    "__main__": 9,
}
LIBRARIES = {
    *("av", "cv2", "gsut_scalar_baseline", "jinja2", "matplotlib", "numpy", "PIL", "simplejpeg"),
    *("tqdm", "yaml"),
    *("fast_simplification", "pillow_heif", "rawpy"),  # optional
}
LIBRARIES |= {"pxr", "zstandard"}  # optional: one format of scene files each
LIBRARIES |= {"ray"}  # optional: many machines
LIBRARIES |= {"rosbags"}  # optional: ROS bags
# calib/ is a program beside gsut: it calls gsut's public names like anybody, and the doors that all
# commands share; gsut starts it as a process. mrcal is imported in one file, which runs under the
# system's Python.
CALIB_LIBRARIES = LIBRARIES | {"calib", "gsut"}
CALIB_DOORS = {"gsut", "gsut.files", "gsut.least_squares", "gsut.lens", "gsut.page", "gsut.run"}
CALIB_WITH_MRCAL = {"calib/inside_mrcal.py"}

MAX_FUNCTION, MAX_CLASS, MAX_FILE = 80, 250, 400  # lines
LONGER: dict[str, str] = {  # "path" or "path:name" -> why it is longer
    "python/gsut/lens/camera.py:Camera": "a lens' public face, mostly docstrings",
    "python/gsut/run/options.py:TrainOptions": "every option with its help",
}


def imports(root: Path, folder: str) -> list[tuple[str, str]]:
    """(path, imported module) of every import; names taken from the package itself are modules."""
    found = []
    for path in sorted((root / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = ["." * node.level + (node.module or "")]
                if names == ["gsut"]:
                    inner = {alias.name for alias in node.names}
                    names = [f"gsut.{n}" if n in FLOORS else "gsut" for n in inner]
            else:
                continue
            found += [(str(path.relative_to(root)), name) for name in names]
    return found


def is_allowed(path: str, target: str) -> bool:
    head, *rest = target.split(".")
    if head != "gsut":
        return head in sys.stdlib_module_names or head in LIBRARIES
    source = Path(path).with_suffix("").parts[2]
    if source not in FLOORS:
        return False
    if not rest:
        return FLOORS[source] >= FLOORS["__init__"]
    if rest[0] == source:
        return True
    is_door = len(rest) == 1 or (ROOT / "python/gsut" / "/".join(rest)).is_dir()  # or a room's room
    return is_door and FLOORS.get(rest[0], 99) < FLOORS[source]


def forbidden(root: Path) -> list[tuple[str, str]]:
    return [arrow for arrow in imports(root, "python/gsut") if not is_allowed(*arrow)]


def test_folders_import_doors_of_lower_floors_only():
    assert len(imports(ROOT, "python/gsut")) >= 300
    assert forbidden(ROOT) == []


def test_calib_uses_the_public_names_of_gsut_only():
    arrows = imports(ROOT, "calib")
    assert len({path for path, _ in arrows}) >= 25
    wrong = []
    for path, target in arrows:
        head = target.split(".")[0]
        libraries = CALIB_LIBRARIES | ({"mrcal"} if path in CALIB_WITH_MRCAL else set())
        past_door = head == "gsut" and target not in CALIB_DOORS
        if past_door or head not in libraries | sys.stdlib_module_names:
            wrong.append((path, target))
    assert wrong == []


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("data/a.py", "from gsut.train import train"),  # against the way of the data
        ("data/a.py", "from gsut.formats import load_ply"),  # of the same floor
        ("evaluate/a.py", "from gsut.lens.camera import Camera"),  # past the door
        ("refine/a.py", "import gsut"),  # the package, below the command line
        ("data/a.py", "from . import scene"),  # relative: the reader cannot see the arrow
        ("train.py", "def f():\n    from gsut.cli import main"),
        ("train.py", "import torch"),
        ("render/a.py", "from scipy import ndimage"),  # for tests only
        ("surprise.py", "from gsut._core import InputError"),  # a module of no floor
    ],
)
def test_import_against_the_design_is_found(tmp_path, path, line):
    file = tmp_path / "python/gsut" / path
    file.parent.mkdir(parents=True)
    file.write_text(line + "\n")
    assert len(forbidden(tmp_path)) == 1


def too_long(path: Path) -> list[str]:
    """What of a Python file does not fit a screen, as "path:name length"."""
    name, text = str(path.relative_to(ROOT)), path.read_text()
    pieces = [(name, len(text.splitlines()), MAX_FILE)]
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            most = MAX_CLASS if isinstance(node, ast.ClassDef) else MAX_FUNCTION
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if isinstance(node, ast.FunctionDef) and ast.get_docstring(node) is not None:
                lines -= (node.body[0].end_lineno or 0) - node.body[0].lineno + 1
            pieces.append((f"{name}:{node.name}", lines, most))
    return [f"{where} {lines}" for where, lines, most in pieces if lines > most]


def test_functions_fit_a_screen():
    checked = [p for f in ("python", "calib") for p in sorted((ROOT / f).rglob("*.py"))]
    assert len(checked) >= 150
    longer = [row for path in checked for row in too_long(path)]
    assert [row for row in longer if row.split()[0] not in LONGER] == []
    assert len(longer) == len(LONGER)  # none is excused that needs it no more
