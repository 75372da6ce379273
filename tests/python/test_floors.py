"""Who imports whom: the contracts of pyproject.toml, doors, libraries; what fits a screen."""

import ast
import importlib
import sys
from pathlib import Path

import pytest

grimp = pytest.importorskip("grimp")  # needs Python 3.11
lint_imports = pytest.importorskip("importlinter.cli").lint_imports

ROOT = Path(__file__).resolve().parents[2]
MAX_DOOR, MAX_DOORS = 30, 278  # names that a folder's door gives; those of floors together
WIDER_DOORS = {"files": 51}  # through which alone all others read and write, a name a kind of file
LIBRARIES = {
    *("av", "cv2", "jinja2", "numpy", "PIL", "simplejpeg", "tqdm", "yaml"),
    # Optional: photographs, USD, SPZ, clusters, ROS bags.
    *("pillow_heif", "rawpy", "pxr", "zstandard", "ray", "rosbags", "laspy", "lzfse"),
}
# These alone import the package gsut itself: the public names.
WHOLE_PACKAGE = ("gsut.cli", "gsut.torch", "gsut.__main__")
# calib/ is a program beside gsut that `gsut calibrate` loads: it uses gsut's public names and the
# doors that all commands share. One file imports mrcal; it runs under the system's Python and
# imports nothing else of ours.
CALIB_DOORS = {"gsut", "gsut.files", "gsut.least_squares", "gsut.lens", "gsut.page", "gsut.run"}
CALIB_WITH_MRCAL = "calib.solve.inside_mrcal"

MAX_FUNCTION, MAX_CLASS, MAX_FILE = 80, 250, 400  # lines


def test_folders_and_rooms_import_lower_floors_only_and_no_circle(capsys):
    status = lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_logo=True, no_cache=True)
    assert status == 0, capsys.readouterr().out


def is_inside(module: str, package: str) -> bool:
    return f"{module}.".startswith(f"{package}.")


def find_fault(importer: str, imported: str, line: str, doors: set[str]) -> str:
    """Says what is wrong with an import; empty if nothing is.

    Args:
        importer, imported: full names; of another library its first word.
        line: as it is written. What the compiled module `gsut._core` gives counts as of `gsut`.
        doors: folders, and what they give; other modules are imported within their folder only.
    """
    top = imported.partition(".")[0]
    if importer == CALIB_WITH_MRCAL:
        return (
            "" if top in {"mrcal", "numpy"} | sys.stdlib_module_names else "not for mrcal's Python"
        )
    if top not in ("gsut", "calib"):
        is_its_own = top == "torch" and is_inside(importer, "gsut.torch")  # optional
        known = is_its_own or top in sys.stdlib_module_names or top in LIBRARIES
        return "" if known else "unknown library"
    if is_inside(importer, "calib"):
        return "" if top == "calib" or imported in CALIB_DOORS else "no public name"
    if imported == "gsut":
        may = "_core" in line or any(is_inside(importer, each) for each in WHOLE_PACKAGE)
        return "" if may or importer == "gsut" else "the whole package"
    folder = imported.rpartition(".")[0]
    return "" if imported in doors or is_inside(importer, folder) else "past the door"


def test_imports_use_doors_and_known_libraries():
    graph = grimp.build_graph("gsut", "calib", include_external_packages=True, cache_dir=None)
    own = {name for name in graph.modules if name.split(".")[0] in ("gsut", "calib")}
    doors = {name for name in own if graph.find_children(name)}
    for folder in sorted(doors - {"gsut.torch"}):
        given = vars(importlib.import_module(folder)).items()  # also functions named as their file
        doors |= {f"{folder}.{name}" for name, value in given if callable(value)}
    faults, count = [], 0
    for importer in sorted(own):
        for imported in sorted(graph.find_modules_directly_imported_by(importer)):
            for arrow in graph.get_import_details(importer=importer, imported=imported):
                count += 1
                if fault := find_fault(importer, imported, arrow["line_contents"], doors):
                    faults.append(f"{importer}:{arrow['line_number']} imports {imported}: {fault}")
    assert count >= 3000
    assert faults == []


@pytest.mark.parametrize(
    ("importer", "imported", "line"),
    [
        ("gsut.evaluate.a", "gsut.lens.camera", "from gsut.lens.camera import Camera"),
        ("gsut.data.b", "gsut.data.low.c", "from gsut.data.low.c import C"),  # past a room's door
        ("gsut.refine.a", "gsut", "import gsut"),  # the package, below the command line
        ("gsut.train", "torch", "import torch"),
        ("gsut.render.a", "scipy", "from scipy import ndimage"),  # for tests only
        ("calib.solve.a", "gsut.data", "from gsut.data import Scene"),
        (CALIB_WITH_MRCAL, "calib.errors", "import calib.errors"),
    ],
)
def test_import_against_the_design_is_found(importer, imported, line):
    doors = {"gsut", "gsut.lens", "gsut.data", "gsut.data.low"}
    assert find_fault(importer, imported, line, doors) != ""


def list_given(door: Path) -> list[str]:
    """The names that a folder's door gives: its __all__, else what it imports."""
    given = []
    for node in ast.parse(door.read_text("utf-8")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return ast.literal_eval(node.value)
        if isinstance(node, ast.ImportFrom) and node.module != "__future__":
            given += [each.asname or each.name for each in node.names]
    return given


def test_doors_are_narrow():
    package = ROOT / "python/gsut"
    doors = {p.parent.relative_to(package).as_posix(): p for p in package.glob("**/__init__.py")}
    del doors["."]  # the public names, which another test lists
    del doors["cli"], doors["torch"]  # which nobody imports
    widths = {folder: len(list_given(door)) for folder, door in doors.items()}
    assert len(widths) >= 40
    assert {k: n for k, n in widths.items() if n > WIDER_DOORS.get(k, MAX_DOOR)} == {}
    narrow = (n for folder, n in widths.items() if "/" not in folder and folder not in WIDER_DOORS)
    assert sum(narrow) <= MAX_DOORS


# --- size -----------------------------------------------------------------------------------------


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
    assert longer == []
