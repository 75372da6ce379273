"""A small whole file of each format that gsut reads, which tests and lab damage."""

from __future__ import annotations

import importlib
import json
import pickle
import pkgutil
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import cv2
import numpy as np

import gsut
import small_datasets
import small_films
import small_recordings
import small_scans
import small_videos
from calib.boards.images import read_grey
from formats.scene_cases import plain_scene
from gsut import formats
from gsut.blocks.layout import Layout
from gsut.capture.exif import read_facts
from gsut.capture.track import read_film_facts
from gsut.capture.turns import read_gcsv
from gsut.capture.video import Video
from gsut.data.capture_file import read_capture
from gsut.data.errors import raise_error
from gsut.data.images.decode import decode_image, decode_mask, read_header
from gsut.data.points import find_usable_points, load_points_ply
from gsut.data.points.las import load_points_las
from gsut.data.poses.camera_path import read_path, read_path_lens
from gsut.data.poses.trajectory import read_trajectory
from gsut.data.rigs import read_rig
from gsut.data.scene.maps import _load_numbers
from gsut.hand_edits import read_edits
from gsut.lens import spread_pixels
from gsut.lifting.lifted import Lifted
from gsut.lifting.map_folder import read_map
from gsut.render.confidence import Confidence
from gsut.run.checkpoint import read_checkpoint, write_checkpoint
from gsut.run.folder import RunFolder, read_run_json
from gsut.run.history import read_history
from gsut.sfm.learned.weights import read_tensors
from gsut.sfm.photographs.moments import read_turns
from gsut.sfm.report.output import read_figures
from gsut.sfm.world import read_positions
from gsut.sfm.world.control_file import read_control
from gsut.surface import Mesh, load_mesh, save_mesh
from lens_cases import FOREIGN_FILES

LENS = gsut.Camera("kannala_brandt", [90, 91, 64, 48, 0.01, 0, 0, 0], 128, 96)
BARREL = gsut.Camera("opencv5", [90, 91, 64, 48, -0.1, 0.02, 1e-3, -1e-3, 0], 128, 96)
POSE = np.eye(4).tolist()
COUNT = 60  # Gaussians of a scene
VERDICT = {"level": "good", "what": "sharp", "reasons": [], "advice": ""}


class Example(NamedTuple):
    """A file, and a function that reads it."""

    file: Path
    read: Callable[[], Any]


Make = Callable[[Path], Example]


def write_values(name: str, values: Any, read: Callable[[Path], Any]) -> Make:
    """Returns a function that writes JSON by this name."""

    def make(folder: Path) -> Example:
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(values))
        return Example(file, lambda: read(file))

    return make


def write_by(name: str, write: Callable[[Path], Any], read: Callable[[Path], Any]) -> Make:
    """Returns a function that writes a file of this name by `write`."""

    def make(folder: Path) -> Example:
        file = folder / name
        write(file)
        return Example(file, lambda: read(file))

    return make


def write_picture(file: Path) -> None:
    cv2.imwrite(str(file), np.random.default_rng(1).integers(0, 255, (20, 30, 3), np.uint8))


def make_confidence() -> Confidence:
    gaussians = plain_scene(np.random.default_rng(1), 9)
    return Confidence.from_sums(gaussians, *np.ones((3, 9)))


def write_stream(file: Path) -> None:
    formats.write_levels(file.parent, [plain_scene(np.random.default_rng(1), 60)], [30.0])


def write_scene(file: Path, version: int = 3) -> None:
    settings = formats.WriteSettings(spz_version=version)
    formats.save_gaussians(file, plain_scene(np.random.default_rng(1), COUNT), settings)


def write_ply(order: str) -> Callable[[Path], Any]:
    """Returns a function that writes another encoding of a PLY file of Gaussians."""

    def write(file: Path) -> None:
        names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
        head = ["ply", f"format {order} 1.0", f"element vertex {COUNT}"]
        head += [f"property float {name}" for name in names.split()]
        rows = np.random.default_rng(2).normal(size=(COUNT, 14))
        text = "".join(" ".join(f"{value:.4f}" for value in row) + "\n" for row in rows).encode()
        body = text if order == "ascii" else rows.astype(">f4").tobytes()
        file.write_bytes("\n".join([*head, "end_header\n"]).encode() + body)

    return write


def read_scene(file: Path) -> None:
    found = formats.load_gaussians(file)
    assert formats._format.find_drawable(found).all()
    assert len(found) <= 2 * COUNT or file.suffix == ".splat"  # which does not say how many


def read_mesh(file: Path) -> None:
    found = load_mesh(file)
    assert np.isfinite(found.vertices).all()
    assert found.faces.max(initial=0) < len(found.vertices)


def read_film(file: Path) -> None:
    with Video(file) as film:
        pictures = [decode() for _, _, decode in film.read_frames()]
        film.list_notes(len(pictures))
    assert {p.shape for p in pictures if p is not None} <= {(film.height, film.width, 3)}


def write_sensors(file: Path) -> None:
    forces = small_films.make_forces([[1, 2, 9.8]] * 5)
    device = small_films.make_gpmf(small_films.make_places(3), forces)
    small_films.make_film(file, b"gpmd", [device] * 3)


def read_sensors(file: Path) -> None:
    facts = read_film_facts(file)
    assert np.isfinite(facts.track).all() and np.isfinite(facts.forces).all()
    assert facts.rotation in (0, 90, 180, 270)


def write_subtitles(file: Path) -> None:
    write_sensors(file.with_suffix(".mp4"))
    cues = (
        f"{i}\n00:00:0{i},000 --> 00:00:0{i + 1},000\n[latitude: 47.{i}] [longitude: 8.5] "
        "[abs_alt: 400]\n\n"
        for i in range(5)
    )
    file.write_text("".join(cues))


def write_mesh(file: Path) -> None:
    rng = np.random.default_rng(3)
    faces = rng.integers(0, 30, (40, 3)).astype(np.uint32)
    colors = rng.uniform(size=(30, 3)).astype(np.float32)
    save_mesh(file, Mesh(rng.normal(size=(30, 3)), faces, colors))


def write_dataset(folder: Path) -> Example:
    small_datasets.write_nerfstudio(folder / "data")
    return Example(folder / "data/transforms.json", lambda: gsut.load_dataset(folder / "data"))


def write_capture(folder: Path) -> Example:
    frame = {"name": "a", "path": "a.png", "time": 0.5, "flow": [[0, 1]], "blurred": False}
    values = {"key": {"inputs": [["a.mp4", 1, 2]]}, "inputs": ["a"], "notes": [], "size": [30, 20],
              "focal_px": 20.5, "frames": [frame]}  # fmt: skip
    return write_values("capture.json", values, lambda file: read_capture(file.parent))(folder)


def write_figures(folder: Path) -> Example:
    values = {
        "registered": 2, "images": 3, "points": 9, "lens": "pinhole", "seconds": {"all": 1.5},
        "reprojection_error_px": {"rms": 0.5, "median": 0.4}, "verdict": VERDICT,
        "lenses": [{"model": "pinhole", "params": [9, 9, 4, 3]}],
    }  # fmt: skip
    return write_values("poses.json", values, lambda file: read_figures(file.parent))(folder)


RIG = {"cameras": {
    name: {"file": "lens.json", "camera_from_reference": [0, 0, 0, place, 0, 0]}
    for name, place in (("a", 0.0), ("b", 0.5))
}}  # fmt: skip


def write_rig(folder: Path) -> Example:
    gsut.save_camera(LENS, folder / "lens.json")
    return write_values("rig.json", RIG, read_rig)(folder)


def write_options(folder: Path) -> Example:
    run = RunFolder.create(folder / "run", gsut.TrainOptions(steps=100))
    return Example(run.path / "options.json", run.read_options)


def write_data(write: Callable[[Path], Any], name: str) -> Make:
    """Returns a function that writes a dataset, of which the first file of this name is damaged."""

    def make(folder: Path) -> Example:
        write(folder / "data")
        file = next(iter(sorted((folder / "data").rglob(name))))
        return Example(file, lambda: gsut.load_dataset(folder / "data"))

    return make


def list_rays() -> np.ndarray:
    pixels = spread_pixels(LENS.width, LENS.height).reshape(-1, 2)
    return np.concatenate([pixels, LENS.unproject(pixels)[0]], axis=1)


def write_table(file: Path) -> None:
    header = "width: 128\nheight: 96\nmodel: kannala_brandt"  # table.npz names none: all are tried
    np.savetxt(file, list_rays(), header=header, delimiter=",")


def write_arrays(file: Path) -> None:
    rays = list_rays()
    np.savez(file, pixels=rays[:, :2], rays=rays[:, 2:], width=128, height=96)


def write_control(file: Path) -> None:
    rows = ("name,use,x,y,z,sigma,picture,u,v", "A,check,1,2,3,0.01,a.png,5,6.5")
    file.write_text("\n".join(rows) + "\n")


def write_tensors(file: Path) -> None:
    """Writes an archive as torch does: a pickle of names and keys, and an array a key."""
    with zipfile.ZipFile(file, "w") as archive:
        names = [("skip1.1.weight", "0"), ("skip1.1.bias", "1")]
        archive.writestr("archive/data.pkl", pickle.dumps(names, protocol=2))
        for _, key in names:
            archive.writestr(f"archive/data/{key}", np.ones(6, "<f4").tobytes())


TREE = {"axis": 0, "at": 1.5, "below": None, "above": None}
# Reader -> its example; see `gsut.files.register_reader`.
EXAMPLES: dict[str, Make] = {
    "JSON of a run": write_values("metrics.json", {"steps": 9, "psnr": 20.5}, read_run_json),
    "camera path": write_values(
        "path.json", {"camera_from_world": [POSE] * 3}, lambda file: read_path(file, None)
    ),
    "capture.json": write_capture,
    "checkpoint": write_by(
        "a.npz",
        lambda file: write_checkpoint(file, {"step": 1, "state": {"a": np.arange(30.0)}}),
        read_checkpoint,
    ),
    "confidence": write_by("b.npz", lambda file: make_confidence().save(file), Confidence.load),
    "dataset": write_dataset,
    "depths": write_by("d.npy", lambda f: np.save(f, np.ones((3, 4))), _load_numbers),
    "facts of a photograph": write_by("a.jpg", write_picture, read_facts),
    "header of a picture": write_by("a.png", write_picture, read_header),
    "history of a run": write_by(
        "history.jsonl", lambda file: file.write_text('{"step": 1, "loss": 0.5}\n'), read_history
    ),
    "laser scan": write_by(
        "cloud.las",
        lambda file: file.write_bytes(small_scans.format_las(np.eye(3))),
        load_points_las,
    ),
    "layout of blocks": write_values(
        "layout.json", {"tree": TREE}, lambda f: Layout.read(str(f))
    ),
    "lens": write_by("o.yaml", lambda file: gsut.save_camera(LENS, file), gsut.load_camera),
    "lens of a camera path": write_values(
        "nerf.json",
        {"camera_path": [{"camera_to_world": POSE, "fov": 50}], "render_height": 60,
         "render_width": 80},
        read_path_lens,
    ),
    "map of a view": write_by("m.npy", lambda f: np.save(f, np.ones((3, 4), np.uint8)), read_map),
    "mask": write_by("mask.png", write_picture, decode_mask),
    "options of a run": write_options,
    "photograph of a board": write_by("board.png", write_picture, read_grey),
    "poses.json": write_figures,
    "control points": write_by("control.csv", write_control, read_control),
    "positions of photographs": write_by(
        "p.csv", lambda file: file.write_text("name,x,y,z\na.png,1,2,3\n"), read_positions
    ),
    "rig": write_rig,
    "trajectory": write_values(
        "poses/poses.json", {"a.png": POSE}, lambda file: read_trajectory(file, raise_error)
    ),
    "edits made in the viewer": write_values(
        "a.edits.json", {"edits": [{"do": "clear"}, {
            "do": "select", "camera_from_world": POSE, "points": [[1, 2], [3, 4], [5, 1]],
            "lens": {"model": "pinhole", "params": [9.0, 9.0, 8.0, 8.0], "width": 16, "height": 16},
        }]}, read_edits,
    ),
    "what was lifted": write_by(
        "l.npz",
        lambda file: Lifted(np.ones((3, 2)), np.ones(3), np.array([2, 7])).save(file),
        Lifted.load,
    ),
    # More files of these readers.
    **{
        name: write_by(name, lambda file: gsut.save_camera(LENS, file), gsut.load_camera)
        for name in ("camchain.yaml", "cameras.bin", "cameras.txt", "gsut.lens.json", "opencv.json",
                     "transforms.json")
    },
    "lens.cameramodel": write_by(
        "lens.cameramodel", lambda file: gsut.save_camera(BARREL, file), gsut.load_camera
    ),
    **{
        name: write_by(
            name, lambda file: file.write_text(FOREIGN_FILES[file.name]), gsut.load_camera
        )
        for name in FOREIGN_FILES
    },
    "table.csv": write_by("table.csv", write_table, gsut.load_camera),
    "table.npz": write_by("table.npz", write_arrays, gsut.load_camera),
    "COLMAP images.txt": write_data(small_datasets.write_colmap_text, "images.txt"),
    "COLMAP points3D.txt": write_data(small_datasets.write_colmap_text, "points3D.txt"),
    "poses.txt": write_data(small_datasets.write_folder, "poses.txt"),
    "EuRoC data.csv": write_data(small_recordings.write_euroc, "data.csv"),
    "EuRoC sensor.yaml": write_data(small_recordings.write_euroc, "sensor.yaml"),
    "weights of learned features": write_by("a.pt", write_tensors, read_tensors),
    # Of binary files.
    **{
        name: write_by(file, write_scene, read_scene)
        for name, file in (
            ("PLY of Gaussians", "s.ply"), ("SOG", "s.sog"), ("SPZ", "s.spz"), ("splat", "s.splat"),
            ("compressed PLY", "s.compressed.ply"), ("glTF of Gaussians", "s.glb"),
        )
    },
    "SPZ 4": write_by("s.spz", lambda file: write_scene(file, 4), read_scene),
    "text PLY of Gaussians": write_by("t.ply", write_ply("ascii"), read_scene),
    "big-endian PLY of Gaussians": write_by("t.ply", write_ply("binary_big_endian"), read_scene),
    "streamed SOG": write_by("lod-meta.json", write_stream, formats.load_gaussians),
    "film": write_by("film.mp4", lambda file: small_videos.walk(file, 12), read_film),
    "large PLY of Gaussians": write_by(
        "large.ply", write_scene, lambda file: formats.open_ply(file, 10_000)
    ),
    "mesh": write_by("m.obj", write_mesh, read_mesh),
    "mesh PLY": write_by("m.ply", write_mesh, read_mesh),
    "PLY of points": write_by(
        "p.ply",
        lambda file: small_datasets.write_ply(file, *small_datasets.points()),
        lambda file: find_usable_points(load_points_ply(file)[0]),
    ),
    **{
        f"COLMAP {name}": write_data(small_datasets.write_colmap_binary, name)
        for name in ("cameras.bin", "images.bin", "points3D.bin")
    },
    **{
        f"picture {suffix}": write_by(
            f"a{suffix}", write_picture, lambda file: (read_header(file), decode_image(file))
        )
        for suffix in (".png", ".jpg", ".webp", ".tif", ".bmp")
    },
    "Gyroflow's log": write_by(
        "film.gcsv",
        lambda file: file.write_text("GYROFLOW IMU LOG\nversion,1.3\nt,gx,gy,gz\n0,1,2,3\n"),
        read_gcsv,
    ),
    "turns beside capture.json": write_by(
        "turns.npz",
        lambda file: np.savez(file, gyroscope=np.ones((3, 4))),
        lambda file: read_turns(
            file.parent, {"turns": {"path": file.name, "records": [{"source": "gyroscope"}]}}
        ),
    ),
    "sensors of a film": write_by("sensors.mp4", write_sensors, read_sensors),
    "subtitles": write_by(
        "a.srt", write_subtitles, lambda file: read_film_facts(file.with_suffix(".mp4"))
    ),
}  # fmt: skip
# Of a library that may not be here.
WITHOUT = {"USD"}
if find_spec("pxr"):
    EXAMPLES["USD"] = write_by("s.usdc", write_scene, formats.load_gaussians)
    WITHOUT = set()


def import_all(package: ModuleType) -> None:
    """Imports every module of a package: each registers its readers."""
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith((".__main__", ".inside_mrcal", ".worker")):
            if module.name.startswith("gsut.torch"):
                continue
            importlib.import_module(module.name)
