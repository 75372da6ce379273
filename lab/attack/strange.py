"""Gives every command what careless people hand over and what other programs write."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import small_videos
from lab.attack.datasets import edit_json
from lab.attack.harness import Case

Make = Callable[[Path], object]
SHORT = ("--steps", "2", "--quiet")
TINY = ("--frames", "1", "--size", "16x16")
POINTS = ("--point", "0", "0", "0", "--point", "1", "0", "0")
# What is done with a thing; IN is its path.
COMMANDS: dict[str, tuple[str, ...]] = {
    "doctor": ("doctor", "IN"),
    "train": ("train", "IN", "-o", "out", *SHORT),
    "data": ("data", "convert", "IN", "out"),
    "poses": ("poses", "IN", "-o", "out", "--quiet"),
    "scene": ("scene", "IN", "-o", "out", *SHORT),
    "calibrate": ("calibrate", "IN", "--board", "5x4", "--spacing", "0.05", "--solver", "opencv",
                  "--lens", "fisheye", "-o", "out.yaml"),
    "camera": ("camera", "convert", "IN", "pinhole"),
    "eval": ("eval", "IN"),
    "render": ("render", "IN", "-o", "out", *TINY),
    "convert": ("convert", "IN", "out.ply"),
    "edit": ("edit", "IN", "-o", "out.ply", "--scale", "2"),
    "compact": ("compact", "IN", "-o", "out.ply", "--keep", "0.5"),
    "mesh": ("mesh", "IN", "-o", "out.ply"),
    "measure": ("measure", "IN", *POINTS),
    "localize": ("localize", "IN", "--run", "run"),
    "localize in": ("localize", "photo.png", "--run", "IN"),
    "view": ("view", "IN", "--serve", "127.0.0.1:0"),
}  # fmt: skip
DATA = frozenset(("doctor", "train", "data", "measure"))
FILE = frozenset(("render", "convert", "edit", "compact", "measure"))
RUN = FILE | DATA | frozenset(("eval", "mesh", "localize in", "localize"))
TAKE = ("poses", "scene", "calibrate")  # photographs, and keep what they found of them
TAKEN = "picture|photograph|image|pair|film|video|frame|matches"  # what they say of them
WAITS = "view"  # which does not end where it takes what it was given


@dataclasses.dataclass(frozen=True)
class Strange:
    """A thing.

    Attributes:
        make: makes it in the scratch folder; None: it is there.
        path: of it.
        said: what each refusal must have; "" for its name.
        passes: commands that may take it in a good sense.
        needs: of the world.
    """

    make: Make | None
    path: str
    said: str = ""
    passes: frozenset[str] = frozenset()
    needs: tuple[str, ...] = ()


def edit_text(name: str, change: Callable[[str], str | bytes]) -> Make:
    def make(folder: Path) -> None:
        changed = change((folder / name).read_text())
        (folder / name).write_bytes(changed.encode() if isinstance(changed, str) else changed)

    return make


def write_as_blender(values: dict[str, Any]) -> dict[str, Any]:
    """As the exporter of synthetic scenes writes it: no size, no suffixes, an angle."""
    frames = [f | {"file_path": "./" + f["file_path"].removesuffix(".png"), "rotation": 0.0125}
              for f in values["frames"]]  # fmt: skip
    return {"camera_angle_x": 0.7, "frames": frames}


def write_as_instant_ngp(values: dict[str, Any]) -> dict[str, Any]:
    extra = {"aabb_scale": 16, "scale": 0.33, "offset": [1, 1, 1], "k1": 0.0, "k2": 0.0,
             "p1": 0.0, "p2": 0.0, "camera_angle_x": 0.9, "camera_angle_y": 0.9, "is_fisheye": 0,
             "integer_depth_scale": 0.001}  # fmt: skip
    frames = [f | {"sharpness": 31.5} for f in values["frames"]]
    del values["camera_model"]
    return values | extra | {"frames": frames}


def write_as_nerfstudio(values: dict[str, Any]) -> None:
    values.update(applied_transform=np.eye(4)[:3].tolist(), applied_scale=1.5,
                  orientation_override="none", auto_scale_poses_override=False)  # fmt: skip
    for number, frame in enumerate(values["frames"]):
        frame.update(colmap_im_id=number, depth_file_path=f"depths/{number}.png", fl_x=40)


def write_as_windows(values: dict[str, Any]) -> None:
    for frame in values["frames"]:
        frame["file_path"] = "D:\\scans\\" + frame["file_path"].replace("/", "\\")
    for key in ("train_filenames", "test_filenames"):
        del values[key]


def write_in_capitals(values: dict[str, Any]) -> None:
    for frame in values["frames"]:
        frame["file_path"] = frame["file_path"].replace(".png", ".PNG")
    for key in ("train_filenames", "test_filenames"):
        del values[key]


def make_shots(fill: Callable[[int], bytes | np.ndarray], count: int = 6, name: str = "{:03d}.png",
             ) -> Make:  # fmt: skip
    """Makes a folder of pictures, "shots"."""

    def make(folder: Path) -> None:
        (folder / "shots").mkdir()
        for number in range(count):
            found = fill(number)
            path = folder / "shots" / name.format(number)
            if not isinstance(found, bytes):
                found = cv2.imencode(".png", found)[1].tobytes()
            path.write_bytes(found)

    return make


def draw_view(number: int, step: float = 4.0) -> np.ndarray:
    return small_videos.view(small_videos.texture(), 300 + step * number)


def write_mesh(folder: Path) -> None:
    """As mesh programs write it: double, faces, normals, big end first."""
    rows = np.zeros(4, [("p", ">f8", 3), ("n", ">f4", 3), ("s", ">f4")])
    rows["p"] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    names = [*(("double", c) for c in "xyz"), *(("float", f"n{c}") for c in "xyz"),
             ("float", "scalar_Intensity")]  # fmt: skip
    header = "ply\nformat binary_big_endian 1.0\ncomment VCGLIB generated\nobj_info 1 points\n"
    header += "element vertex 4\n" + "".join(f"property {k} {n}\n" for k, n in names)
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    face = b"\x03" + np.array([0, 1, 2], ">i4").tobytes()
    (folder / "mesh.ply").write_bytes(header.encode() + rows.tobytes() + face)


def write_sound(folder: Path) -> None:
    """A film without a picture."""
    import av

    with av.open(str(folder / "sound.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=44100)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
        frame.rate = 44100
        for packet in [*stream.encode(frame), *stream.encode(None)]:
            container.mux(packet)


def change_colmap(change: Callable[[Path], object]) -> Make:
    return lambda folder: change(folder / "colmap_text")


def move_images(folder: Path) -> None:
    """Into folders of cameras, which the model knows nothing of."""
    for number, path in enumerate(sorted((folder / "images").iterdir())):
        place = folder / "images" / f"cam{number % 2}"
        place.mkdir(exist_ok=True)
        path.rename(place / path.name)


def pack_zip(folder: Path) -> None:
    with zipfile.ZipFile(folder / "ds.zip", "w") as file:
        for path in sorted((folder / "ds").rglob("*")):
            file.write(path, path.relative_to(folder))


def pack_tar(folder: Path) -> None:
    with tarfile.open(folder / "ds.tar.gz", "w:gz") as file:
        file.add(folder / "ds", "ds")


def nest_dataset(folder: Path) -> None:
    """A dataset in a folder in a folder, as archives unpack."""
    (folder / "download").mkdir()
    (folder / "ds").rename(folder / "download" / "ds")


def rename_with_newline(folder: Path) -> None:
    (folder / "ds/images/003.png").rename(folder / "ds/images/new\nline.png")
    edit_json(lambda values: json.loads(
        json.dumps(values).replace("003.png", "new\\nline.png")))(folder)  # fmt: skip


def exchange_pictures(folder: Path) -> None:
    """Another dataset's photographs under the same names."""
    shutil.rmtree(folder / "ds/images")
    (folder / "plane/images").rename(folder / "ds/images")


THINGS: dict[str, Strange] = {
    "a run": Strange(None, "run", "", RUN, ("ds", "run")),
    "a dataset": Strange(None, "ds", "", DATA, ("ds",)),
    "a run's checkpoint": Strange(None, "run/checkpoint.npz", "", needs=("ds", "run")),
    "a run's figures": Strange(None, "run/metrics.json", "", needs=("ds", "run")),
    "a run's scene": Strange(None, "run/scene.ply", "", FILE, ("ds", "run")),
    "a dataset's table": Strange(None, "ds/transforms.json", "", DATA | {"camera"}, ("ds",)),
    "a dataset's pictures": Strange(None, "ds/images", "", needs=("ds",)),
    "a dataset's points": Strange(None, "ds/points3D.ply", "", needs=("ds",)),
    "a folder around a dataset": Strange(nest_dataset, "download", "", needs=("ds",)),
    "an archive": Strange(pack_zip, "ds.zip", "", needs=("ds",)),
    "a tar archive": Strange(pack_tar, "ds.tar.gz", "", needs=("ds",)),
    "an address": Strange(None, "https://example.com/scan.zip", r"https:/+example\.com"),
    "nothing": Strange(None, "", "empty"),
    "a dash": Strange(None, "-", "-"),
    "a home": Strange(None, "~nobody/scan", "~nobody"),
    "the world": Strange(None, "/", "/"),
    "a lens": Strange(None, "lens48.json", "", frozenset(("camera",)), ("lens48.json",)),
    "an empty bag": Strange(
        lambda f: (f / "walk.bag").write_bytes(b"#ROSBAG V2.0\n"), "walk.bag", r"walk\.bag"),
    "a text": Strange(lambda f: (f / "read.me").write_text("hello\n"), "read.me"),
    "empty pictures": Strange(make_shots(lambda _: b""), "shots"),
    "texts called pictures": Strange(make_shots(lambda _: b"no"), "shots"),
    "one picture": Strange(make_shots(draw_view, 1), "shots"),
    "twins": Strange(make_shots(lambda _: draw_view(0)), "shots"),
    "black pictures": Strange(make_shots(lambda _: draw_view(0) * 0), "shots"),
    "pictures of two sizes": Strange(
        make_shots(lambda i: draw_view(i)[: 240 - 60 * (i % 2)]), "shots", "",
        frozenset(("poses", "scene"))),  # as of two cameras
    "pictures of one pixel": Strange(
        make_shots(lambda _: np.zeros((1, 1, 3), np.uint8)), "shots"),
    "pictures of a line": Strange(
        make_shots(lambda _: np.zeros((1, 9000, 3), np.uint8)), "shots"),
    "pictures with new lines": Strange(make_shots(draw_view, 3, "a\n{}.png"), "shots"),
    "raw pictures of noise": Strange(make_shots(lambda i: bytes(999), 3, "{}.CR2"), "shots"),
    "documents": Strange(make_shots(lambda i: b"%PDF-1.4", 3, "{}.pdf"), "shots"),
    "a film of sound": Strange(write_sound, "sound.mp4"),
    "a film of one frame": Strange(
        lambda f: small_videos.write_video(f / "short.mp4", [draw_view(0)]), "short.mp4"),
    "a film that stands": Strange(
        lambda f: small_videos.write_video(f / "still.mp4", [draw_view(0)] * 9), "still.mp4"),
    "a film of black": Strange(
        lambda f: small_videos.write_video(f / "dark.mp4", [draw_view(0) * 0] * 9), "dark.mp4"),
    "a mesh": Strange(write_mesh, "mesh.ply"),
    "as Blender writes": Strange(edit_json(write_as_blender), "ds", "", DATA, ("ds",)),
    "as instant-ngp writes": Strange(edit_json(write_as_instant_ngp), "ds", "", DATA, ("ds",)),
    "as nerfstudio writes": Strange(edit_json(write_as_nerfstudio), "ds", "", DATA, ("ds",)),
    "as Windows writes": Strange(edit_json(write_as_windows), "ds", "", DATA, ("ds",)),
    "other capitals": Strange(edit_json(write_in_capitals), "ds", "", DATA, ("ds",)),
    "a mark before the text": Strange(
        edit_text("ds/transforms.json", lambda t: b"\xef\xbb\xbf" + t.encode()), "ds", "", DATA,
        ("ds",)),
    "commas at the end": Strange(
        edit_text("ds/transforms.json", lambda t: t[:-1] + ",}"), "ds", needs=("ds",)),
    "lines of Windows": Strange(
        edit_text("colmap_text/sparse/0/images.txt", lambda t: t.replace("\n", "\r\n")),
        "colmap_text", "", DATA, ("colmap_text",)),
    "a model without pictures": Strange(
        change_colmap(lambda p: shutil.rmtree(p / "images")), "colmap_text", "",
        needs=("colmap_text",)),
    "a model of other pictures": Strange(
        change_colmap(move_images), "colmap_text", "", needs=("colmap_text",)),
    "a model of half the pictures": Strange(
        change_colmap(lambda p: [x.unlink() for x in sorted((p / "images").iterdir())[::2]]),
        "colmap_text", "", DATA, ("colmap_text",)),
    "a name of two lines": Strange(rename_with_newline, "ds", "", DATA, ("ds",)),
    "mixed up pictures": Strange(exchange_pictures, "ds", "", needs=("ds", "plane")),
}  # fmt: skip


# Where to write: what the command reads, or what another one wrote.
ONTO: dict[tuple[str, ...], tuple[str, ...]] = {
    ("train", "ds", "-o", "ds", *SHORT): ("ds",),
    ("train", "ds", "-o", "ds/images", *SHORT): ("ds",),
    ("train", "ds", "-o", "ds", "--resume", *SHORT): ("ds",),
    ("train", "run", "-o", "run", "--resume", "--steps", "3", "--quiet"): ("ds", "run"),
    ("train", "plane", "-o", "run", "--resume", "--quiet"): ("ds", "run", "plane"),
    ("poses", "folder", "-o", "folder", "--quiet"): ("folder",),
    ("poses", "folder", "-o", "run", "--quiet"): ("folder", "ds", "run"),
    ("poses", "film.mp4", "-o", "film.mp4", "--quiet"): ("film.mp4",),
    ("scene", "film.mp4", "-o", "ds", "--quiet"): ("film.mp4", "ds"),
    ("scene", "film.mp4", "-o", "run", "--quiet"): ("film.mp4", "ds", "run"),
    ("data", "convert", "ds", "ds"): ("ds",),
    ("data", "convert", "ds", "ds/images"): ("ds",),
    ("data", "convert", "ds", "run"): ("ds", "run"),
    ("data", "convert", "plane", "plane/images/000.png"): ("plane",),
    ("eval", "run", "-o", "ds"): ("ds", "run"),
    ("eval", "run", "-o", "ds/images"): ("ds", "run"),
    ("render", "run", "-o", "run", *TINY): ("ds", "run"),
    ("render", "run", "-o", "ds/images", *TINY): ("ds", "run"),
    ("render", "scenes/a.ply", "-o", "scenes", *TINY): ("scenes/a.ply",),
    ("render", "scenes/a.ply", "-o", "film.mp4", *TINY): ("scenes/a.ply", "film.mp4"),
    ("compact", "run", "-o", "run", "--keep", "0.5"): ("ds", "run"),
    ("compact", "run", "-o", "run/scene.ply", "--keep", "0.5"): ("ds", "run"),
    ("compact", "scenes/a.ply", "-o", "scenes/a.ply", "--keep", "0.5"): ("scenes/a.ply",),
    ("convert", "scenes/a.ply", "scenes/a.ply"): ("scenes/a.ply",),
    ("convert", "run", "run/scene.ply"): ("ds", "run"),
    ("edit", "scenes/a.ply", "-o", "scenes/a.ply", "--scale", "2"): ("scenes/a.ply",),
    ("edit", "run", "-o", "run/scene.ply", "--scale", "2"): ("ds", "run"),
    ("edit", "run", "-o", "run", "--scale", "2"): ("ds", "run"),
    ("mesh", "run", "-o", "run/scene.ply"): ("ds", "run"),
    ("mesh", "run", "-o", "ds/points3D.ply"): ("ds", "run"),
    ("camera", "convert", "lens48.json", "pinhole", "-o", "lens48.json"): ("lens48.json",),
    ("calibrate", "boards", "--board", "5x4", "--spacing", "0.05", "--solver", "opencv", "--lens",
     "fisheye", "-o", "boards/02.png"): ("boards",),
}  # fmt: skip


def list_strange_cases() -> Iterator[Case]:
    """Lists every thing with every command, and every command onto what is there."""
    for words, needs in ONTO.items():
        yield Case("onto", "what is there", words, needs, said=(r"\w",), keeps=("out",))
    for name, thing in THINGS.items():
        for command, words in COMMANDS.items():
            if command == WAITS and thing.passes:
                continue
            given = tuple(thing.path if word == "IN" else word for word in words)
            needs, said = thing.needs, thing.said or re.escape(Path(thing.path).name)
            if "run" in given or "photo.png" in given:
                needs = tuple(dict.fromkeys((*needs, "ds", "run", "photo.png")))
            yield Case(
                "strange", name, given, needs, thing.make,
                (f"{said}|{TAKEN}" if command in TAKE else said,),
                may_pass=command in thing.passes, keeps=("out",) if command in TAKE else (),
            )  # fmt: skip
