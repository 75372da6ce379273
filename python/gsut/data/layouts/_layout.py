"""A layout of datasets: how its files are recognised, read and written."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import pkgutil
from collections.abc import Callable, Collection
from pathlib import Path

from gsut.data.errors import DatasetError, OnError
from gsut.data.export import Export
from gsut.data.listing import Listing
from gsut.data.recordings import Recording


@dataclasses.dataclass(frozen=True)
class Layout:
    """One way to lay out a dataset's files.

    Args:
        name: for `gsut data convert --to`.
        files: what is looked for, in words: for errors.
        rank: where the files of several are there, the lowest one is read.
        holds: whether this folder (or file) is one.
        read: its frames, points and lists; the argument is what `holds` accepted.
        record: instead of `read`, of a layout whose poses are found by time or order.
        write: into a new folder; None where gsut only reads the layout.
        unpack: of what holds pictures inside, such as a bag: writes them to a folder; instead of
            `read` and `record`, of which it returns the result.
    """

    name: str
    files: str
    rank: int
    holds: Callable[[Path], bool]
    read: Callable[[Path, OnError], Listing] | None = None
    record: Callable[[Path], Recording] | None = None
    write: Callable[[Path, Export], list[str]] | None = None
    unpack: Callable[..., Recording | Listing] | None = None


@functools.cache
def list_layouts() -> tuple[Layout, ...]:
    """Returns every layout whose module lies in this folder, in the order of their ranks."""
    package = __name__.rpartition(".")[0]
    folder = [str(Path(__file__).parent)]
    names = [m.name for m in pkgutil.iter_modules(folder) if not m.name.startswith("_")]
    modules = [importlib.import_module(f"{package}.{name}") for name in names]
    found = [layout for module in modules for layout in module.LAYOUTS]
    return tuple(sorted(found, key=lambda layout: layout.rank))


def find_layout(path: Path, without: Collection[str] = ()) -> Layout | None:
    """Returns the first layout that finds its files here, except those of these names."""
    known = (each for each in list_layouts() if each.name not in without)
    return next((each for each in known if each.holds(path)), None)


_WRITE_POSES = (
    "write its poses, camera-to-world with OpenCV axes, to poses.json and its lens to lens.yaml"
)
# Files by which projects of other programs are recognised, and how to get from there.
_FOREIGN = {
    "cameras.xml": "Metashape's: export the cameras as COLMAP",
    "*.psx": "Metashape's: export the cameras as COLMAP",
    "reconstruction.json": "OpenSfM's: run `opensfm export_colmap`",
    "*.sfm": "Meshroom's: export its cameras as COLMAP",
    "*.mg": "Meshroom's: export its cameras as COLMAP",
    "sfm_data*.json": "OpenMVG's: run openMVG_main_openMVG2Colmap",
    "bundle*.out": "Bundler's: convert it with COLMAP",
    "*.nvm": "VisualSFM's: export it as COLMAP",
    "*.rcproj": "RealityScan's: export the registration as COLMAP",
    "*.rspj": "RealityScan's: export the registration as COLMAP",
    "*.rsproj": "RealityScan's: export the registration as COLMAP",
    "*.opf": "Pix4D's: export the cameras as COLMAP",
    "*.p4d": "Pix4D's: export the cameras as COLMAP",
    "calibrated_cameras.json": "Pix4D's (OPF): export the cameras as COLMAP",
    "*calibrated_camera_parameters.txt": "Pix4D's: export the cameras as COLMAP",
    "poses_bounds.npy": "LLFF's: give the COLMAP model that it was made of",
    "*.ccm": "iTwin Capture's: export the cameras as COLMAP",
    "cameras.json": "3DGS's: give the dataset that it was trained on",
    "cams/*_cam.txt": f"MVSNet's: {_WRITE_POSES}",
    "*.pose.txt": f"of 7-Scenes: {_WRITE_POSES}",
    "pose/0*.txt": f"of ScanNet or NSVF: {_WRITE_POSES}",
    "poses/0*.txt": f"of ScanNet or NSVF: {_WRITE_POSES}",
    "*.npz": f"arrays of numpy: {_WRITE_POSES}",
    "poses.npy": f"an array of numpy: {_WRITE_POSES}",
    "*.log": f"of Tanks and Temples, if it is a trajectory: {_WRITE_POSES}",
    "*.mvs": "OpenMVS's: give the COLMAP model that it was made of",
    "BlocksExchange*.xml": "iTwin Capture's: export the cameras as COLMAP",
    "images/*.xmp": "RealityScan's: if it has poses, export the registration as COLMAP",
    "*.xmp": "RealityScan's: if it has poses, export the registration as COLMAP",
    "database.db": "COLMAP's, without a model: run `colmap mapper`",
    "*.r3d": "Record3D's archive: run `gsut data convert FILE OUT`",
    "*.e57": "a laser scanner's: export the cloud as LAS or PLY",
    "*.csv": "a table; if of RealityScan's poses, export the registration as COLMAP",
    "*.zip": "packed: unpack it and give its folder",
}


def find_foreign_files(path: Path) -> str:
    """Names files of other programs' projects, in a folder or given, and what to do with them."""
    found = (
        f"{file.name} is {whose}"
        for pattern, whose in _FOREIGN.items()
        for file in (sorted(path.glob(pattern))[:1] if path.is_dir() else [path])
        if file.match(pattern)
    )
    return "; ".join(found)


def require_pictures(path: Path) -> None:
    """Requires that pictures do not lie inside a file, as in a ROS bag.

    Raises:
        DatasetError: they do; says which command takes them out.
    """
    layout = find_layout(path) if path.exists() else None
    if layout is not None and layout.unpack is not None:
        raise DatasetError(
            path, f"{layout.files}, whose pictures are inside",
            f"`gsut data convert {path} FOLDER` makes a dataset of it; without poses, folders of "
            "pictures, whose poses gsut finds",
        )  # fmt: skip
