"""The floors of the Python side: a folder imports doors of lower floors only."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# Folder (or module) of python/gsut -> floor; below 1 is what the folders of floor 1 share.
FLOORS = {
    "_core": -3,
    **dict.fromkeys(("_starting", "orientation", "system"), -2),
    **dict.fromkeys(("files", "least_squares", "metrics", "significance", "time_left"), -1),
    "output_folder": 0,
    **dict.fromkeys(("gaussians", "lens", "run", "page"), 1),
    **dict.fromkeys(("render", "optimize", "data", "formats"), 2),
    **dict.fromkeys(("capture", "sfm", "evaluate", "compact", "surface", "lifting"), 3),
    **dict.fromkeys(("refine", "check", "demo"), 4),
    "training": 5,
    **dict.fromkeys(("train", "blocks", "view", "scene_folder"), 6),
    **dict.fromkeys(("scene", "poses", "edit", "loop", "rendering", "machine"), 7),
    **dict.fromkeys(("__init__", "cli"), 8),
    **dict.fromkeys(("__main__", "torch"), 9),
}
# Folder -> its own rooms -> floor: a room imports doors of lower rooms. The files beside the rooms
# need no floor: no circle leads through them.
ROOMS: dict[str, dict[str, int]] = {
    "calib": {"boards": 1, "camera": 2, "solve": 3, "trust": 4, "report": 5},
    "python/gsut/compact": {"methods": 1},
    "python/gsut/data": {
        **dict.fromkeys(("colmap", "images", "poses"), 1),
        **dict.fromkeys(("scene", "rigs"), 2),
        **dict.fromkeys(("points", "recordings"), 3),
        "layouts": 4,
    },
    "python/gsut/lens": {"files": 1},
    "python/gsut/run": {"options": 1, "verdicts": 2},
    "python/gsut/sfm": {
        "photographs": 1,
        "matches": 2,
        "solution": 3,
        "mapping": 4,
        **dict.fromkeys(("lens", "points", "world"), 5),
        **dict.fromkeys(("starts", "shutter"), 6),
        "rig": 7,
        "report": 8,
    },
    "python/gsut/surface": {"stereo": 1},
    "python/gsut/training": {
        **dict.fromkeys(("first", "strategies", "surface"), 1),
        "photograph": 2,
        "record": 3,
        "tuning": 4,
    },
}
MAX_DOOR, MAX_DOORS = 30, 278  # names in a folder's __all__; in those of floors together
LIBRARIES = {
    *("av", "cv2", "gsut_scalar_baseline", "jinja2", "numpy", "PIL", "simplejpeg"),
    *("tqdm", "yaml"),
    *("fast_simplification", "pillow_heif", "rawpy"),  # optional
}
LIBRARIES |= {"pxr", "zstandard"}  # optional: one format of scene files each
LIBRARIES |= {"ray"}  # optional: many machines
LIBRARIES |= {"rosbags"}  # optional: ROS bags
# calib/ is a program beside gsut that `gsut calibrate` loads: it uses gsut's public names and the
# doors that all commands share. One file imports mrcal; it runs under the system's Python and
# imports nothing else of ours.
CALIB_DOORS = {"gsut", "gsut.files", "gsut.least_squares", "gsut.lens", "gsut.page", "gsut.run"}
CALIB_WITH_MRCAL = "calib/solve/inside_mrcal.py"

MAX_FUNCTION, MAX_CLASS, MAX_FILE = 80, 250, 400  # lines
LONGER: dict[str, str] = {  # "path" or "path:name" -> why it is longer
    "python/gsut/run/options/train.py:TrainOptions": "every option with its help",
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
    source = Path(path).with_suffix("").parts[2]
    if head != "gsut":
        is_its_own = head == "torch" and source == "torch"  # optional, in one folder only
        return is_its_own or head in sys.stdlib_module_names or head in LIBRARIES
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


def is_allowed_in_calib(path: str, target: str) -> bool:
    head = target.split(".")[0]
    if path == CALIB_WITH_MRCAL:
        return head in {"mrcal", "numpy"} | sys.stdlib_module_names
    if head == "gsut":
        return target in CALIB_DOORS
    return head in {"calib"} | LIBRARIES | sys.stdlib_module_names


def test_calib_uses_the_public_names_of_gsut_only():
    arrows = imports(ROOT, "calib")
    assert len({path for path, _ in arrows}) >= 25
    assert [arrow for arrow in arrows if not is_allowed_in_calib(*arrow)] == []


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


# --- inside a folder ------------------------------------------------------------------------------


def name_package(folder: Path) -> str:
    return f"gsut.{folder.name}" if folder.parent.name == "gsut" else folder.name


def list_modules(folder: Path) -> dict[str, Path]:
    """Returns the modules of a package by their full names, without the package's door."""
    modules = {}
    for path in sorted(folder.rglob("*.py")):
        parts = (name_package(folder), *path.relative_to(folder).with_suffix("").parts)
        modules[".".join(parts).removesuffix(".__init__")] = path
    del modules[name_package(folder)]
    return modules


def find_arrows(modules: dict[str, Path]) -> dict[str, set[str]]:
    """Returns which of these modules each one imports, anywhere in its text."""
    arrows: dict[str, set[str]] = {}
    for name, path in modules.items():
        targets = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                targets |= (inner & modules.keys()) or {node.module}
            elif isinstance(node, ast.Import):
                targets |= {alias.name for alias in node.names}
        arrows[name] = (targets & modules.keys()) - {name}
    return arrows


def find_circles(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Returns the groups of nodes that lead back to themselves."""

    def reach(start: str) -> set[str]:
        seen, waiting = set(), [start]
        while waiting:
            new = arrows[waiting.pop()] - seen
            seen |= new
            waiting += new
        return seen

    reached = {node: reach(node) for node in arrows}
    circles = {
        tuple(
            sorted(other for other in arrows if node in reached[other] and other in reached[node])
        )
        for node in arrows
    }
    return sorted(list(circle) for circle in circles if circle)


def find_faults_inside(folder: Path, floors: dict[str, int]) -> list[str]:
    """Returns circles between the files of a folder, and arrows against its rooms' floors."""
    modules = list_modules(folder)
    arrows = find_arrows(modules)
    depth = len(name_package(folder).split("."))
    rooms = {p.parent.name for p in folder.glob("*/__init__.py")}
    if rooms != set(floors):
        return [f"{folder}: rooms {sorted(rooms)}, but floors of {sorted(floors)} (see ROOMS)"]
    unit = {name: name.split(".")[depth] for name in modules}
    between: dict[str, set[str]] = {each: set() for each in unit.values()}
    faults = []
    for name, target in ((n, t) for n, targets in arrows.items() for t in targets):
        if unit[name] == unit[target]:
            continue
        between[unit[name]].add(unit[target])
        is_past_door = unit[target] in rooms and len(target.split(".")) > depth + 1
        both = {unit[name], unit[target]} <= rooms
        is_upward = both and floors[unit[target]] >= floors[unit[name]]
        if is_past_door or is_upward:
            faults.append(f"{name} imports {target}")
    circles = [c for graph in (arrows, between) for c in find_circles(graph)]
    return faults + [f"circle: {', '.join(circle)}" for circle in circles]


FOLDERS = [
    *(path.parent for path in sorted((ROOT / "python/gsut").glob("*/__init__.py"))),
    ROOT / "calib",
]


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_a_folder_has_no_circles_and_its_rooms_have_floors(folder):
    assert find_faults_inside(folder, ROOMS.get(str(folder.relative_to(ROOT)), {})) == []


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("a.py", "from gsut.data.b import B"),  # a circle of two files
        ("low/c.py", "from gsut.data.high import D"),  # up a floor
        ("b.py", "from gsut.data.low.c import C"),  # past the room's door
        ("high/d.py", "from gsut.data.a import A"),  # a circle through a file beside the rooms
    ],
)
def test_an_import_against_the_floors_of_rooms_is_found(tmp_path, path, line):
    texts = {
        "__init__.py": "from gsut.data.a import A",
        "a.py": "from gsut.data.high import D",
        "b.py": "from gsut.data.a import A",
        "low/__init__.py": "",
        "low/c.py": "",
        "high/__init__.py": "",
        "high/d.py": "from gsut.data.low import C",
    }
    folder = tmp_path / "gsut/data"
    for name, text in texts.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text + "\n")
    floors = {"low": 1, "high": 2}
    assert find_faults_inside(folder, floors) == []
    (folder / path).write_text(f"{texts[path]}\n{line}\n")
    assert len(find_faults_inside(folder, floors)) >= 1


def test_doors_are_narrow():
    package, widths = ROOT / "python/gsut", {}
    for path in package.glob("**/__init__.py"):
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
                folder = path.parent.relative_to(package).as_posix()
                widths[folder] = len(ast.literal_eval(node.value))
    del widths["."]  # the public names, which another test lists
    assert len(widths) >= 40
    assert {k: n for k, n in widths.items() if n > MAX_DOOR} == {}
    assert sum(n for folder, n in widths.items() if "/" not in folder) <= MAX_DOORS


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
    assert [row for row in longer if row.split()[0] not in LONGER] == []
    assert len(longer) == len(LONGER)  # none is excused that needs it no more
