"""What a dataset leaves open is asked for, converted with a note, or refused; never guessed."""

import json

import cv2
import numpy as np
import pytest

import gsut
import small_datasets as small
import tolerances
from gsut.check import check_scene
from gsut.data.poses import OPENGL_FROM_OPENCV

OPENCV = """%YAML:1.0
---
image_width: 48
image_height: 36
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 40., 0., 24., 0., 41., 17., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: {count}
   dt: d
   data: [ {values} ]
"""


def plain(path, count=4, values="0.1, 0.01, 0.0, 0.001", model=""):
    """A plain folder whose lens is an OpenCV file."""
    small.write_folder(path)
    for file in path.glob("lens.*"):
        file.unlink()
    (path / "lens.yaml").write_text(OPENCV.format(count=count, values=values) + model)


def edited(path, **keys):
    small.write_nerfstudio(path)
    values = json.loads((path / "transforms.json").read_text())
    for key, value in keys.items():
        values.pop(key, None) if value is None else values.update({key: value})
    (path / "transforms.json").write_text(json.dumps(values))


def edit_frames(path, **columns):
    """Writes values under these keys of the first frames."""
    values = small.transforms()
    for key, column in columns.items():
        for frame, value in zip(values["frames"], column, strict=False):
            frame[key] = value
    small.write_nerfstudio(path, values)


def write_sixteen_bits(path, factor):
    """Pixels of 8 bits times a factor, in files of 16."""
    small.write_nerfstudio(path)
    for file in (path / "images").iterdir():
        cv2.imwrite(str(file), cv2.imread(str(file)).astype(np.uint16) * factor)


def masks(path, names):
    small.write_folder(path)
    for name in names:
        (path / "masks").mkdir(exist_ok=True)
        cv2.imwrite(str(path / "masks" / name), np.full((small.HEIGHT, small.WIDTH), 255, np.uint8))


def float_colours(path):
    small.write_nerfstudio(path)
    values = json.loads((path / "transforms.json").read_text())
    header = "ply\nformat ascii 1.0\nelement vertex 2\n"
    for name in ("x", "y", "z", "red", "green", "blue"):
        header += f"property float {name}\n"
    rows = "0 0 0 10 20 255\n1 0 0 30 40 50\n"
    (path / values["ply_file_path"]).write_text(header + "end_header\n" + rows)


def write_cameras(path, labels="{folder}/{file}", lenses=("cam0.json", "cam1.json")):
    """Pictures of two cameras in folders, lens files beside them, and a pose for each picture."""
    values = small.transforms()
    rows = []
    for i, frame in enumerate(values["frames"]):
        folder, file = f"cam{i % 2}", f"{i // 2:03d}.png"
        small.write_png(
            path / "images" / folder / file, small.render(small.world_from_cameras()[i])
        )
        pose = np.array(frame["transform_matrix"]) @ OPENGL_FROM_OPENCV
        label = labels.format(folder=folder, file=file)
        w, *turn = small.quaternion(pose[:3, :3])
        rows.append(" ".join([label, *(f"{v:.17g}" for v in [*pose[:3, 3], *turn, w])]))
    (path / "poses.txt").write_text("\n".join(rows) + "\n")
    for number, name in enumerate(lenses):
        params = [small.FX + number, small.FY, small.CX, small.CY]
        gsut.save_camera(gsut.Camera("pinhole", params, small.WIDTH, small.HEIGHT), path / name)


HALF = [f"{i:03d}.png" for i in range(0, small.VIEWS, 2)]
# What is open, how it is made, and the words of the refusal.
REFUSED = [
    ("four coefficients, no model", plain, "nothing says which"),
    ("four coefficients, unknown model", lambda p: plain(p, model="distortion_model: best\n"),
     "nothing says which"),
    ("field of view in degrees",
     lambda p: edited(p, fl_x=None, fl_y=None, camera_angle_x=61.9), "degrees\\? write 1.08"),
    ("valid field angle in degrees", lambda p: edited(p, max_theta_rad=95.0),
     "degrees\\? write 1.658"),
    ("masks under other names", lambda p: masks(p, ["mask_0.png", "mask_1.png"]),
     "none of 2 masks belongs to an image: mask_0.png, mask_1.png; a mask is called as its image"),
    ("names that pictures of two cameras have", lambda p: write_cameras(p, "{file}"),
     "'000.png' fits 2 pictures: cam0/000.png, cam1/000.png; begin each line with the picture's"),
    ("a lens for one of two cameras", lambda p: write_cameras(p, lenses=["cam0.json"]),
     "of cam0 have a lens file, cam0.json, and those of cam1 have none"),
    ("lenses of other names", lambda p: write_cameras(p, lenses=["left.yaml", "right.yaml"]),
     "several lenses: left.yaml, right.yaml; call the one of these pictures lens.yaml"),
]  # fmt: skip
# ... and the words of the note.
NOTED = [
    ("colours of 0 to 255 as floating-point numbers", float_colours, "numbers of 0 to 255"),
    ("masks for half of the images", lambda p: masks(p, HALF), "5 of 10 images have no mask"),
    ("masks for more than the images", lambda p: masks(p, [*HALF, "x.png"]),
     "1 masks are of no image: x.png"),
    ("all k zero", lambda p: plain(p, 5, "0.0, 0.0, 0.0, 0.0, 0.0"), "coefficients that are all 0"),
    ("all k of a fisheye zero",
     lambda p: plain(p, 4, "0.0, 0.0, 0.0, 0.0", "distortion_model: equidistant\n"),
     "taken to be an equidistant fisheye"),
    ("times that are none", lambda p: edit_frames(p, timestamp=[0, 1, float("nan"), "3", 1e300]),
     "'timestamp' of 3 frames is no number of seconds and is left out: images/002.png"),
    ("nanoseconds that are none", lambda p: edit_frames(p, timestamp_ns=[0, float("nan"), True]),
     "'timestamp_ns' of 2 frames is no number of nanoseconds"),
    ("a rolling shutter without its poses",
     lambda p: edited(p, rolling_shutter={"direction": "top_to_bottom"}),
     "10 of 10 frames have no transform_matrix_start"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("make", "words"), [row[1:] for row in REFUSED], ids=[r[0] for r in REFUSED]
)
def test_what_is_open_is_refused_with_what_to_do(make, words, tmp_path):
    make(tmp_path / "data")
    with pytest.raises(gsut.InputError, match=words):
        gsut.load_dataset(tmp_path / "data")


@pytest.mark.parametrize(("make", "words"), [row[1:] for row in NOTED], ids=[r[0] for r in NOTED])
def test_what_is_converted_is_noted(make, words, tmp_path):
    make(tmp_path / "data")
    notes = gsut.load_dataset(tmp_path / "data").notes
    assert len([note for note in notes if words in note]) == 1, notes
    findings = gsut.doctor(tmp_path / "data", progress=False)
    assert any(words in finding.what and finding.severity == "warning" for finding in findings)


def test_path_of_a_picture_is_not_taken_for_the_file_name_of_another(tmp_path):
    write_cameras(tmp_path / "data", lenses=["lens.json"])
    images = tmp_path / "data" / "images"
    for file in sorted((images / "cam1").iterdir()):
        file.rename(images / file.name)  # beside cam0, whose pictures come first
    text = (tmp_path / "data" / "poses.txt").read_text().replace("cam1/", "")
    (tmp_path / "data" / "poses.txt").write_text(text)
    scene = gsut.load_dataset(tmp_path / "data", test_every=0)
    assert len(scene) == small.VIEWS and not scene.notes
    for view in scene.views:
        row = 2 * int(view.image_path.stem) + (view.image_path.parent == images)
        centre = small.world_from_cameras()[row][:3, 3]
        np.testing.assert_allclose(view.camera_center, centre, atol=tolerances.LAYOUT_POSE)


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_four_coefficients_with_a_model_are_read(model, tmp_path):
    plain(tmp_path / "data", model=f"distortion_model: {model}\n")
    (camera,) = gsut.load_dataset(tmp_path / "data").cameras
    assert camera.model == {"plumb_bob": "opencv4", "equidistant": "kannala_brandt"}[model]


def test_twelve_bits_in_files_of_sixteen_are_refused_before_training(tmp_path):
    write_sixteen_bits(tmp_path / "data", 16)
    findings = check_scene(gsut.load_dataset(tmp_path / "data"))
    (said,) = [f for f in findings if "bits a channel" in f.what]
    assert said.severity == "error" and "12 bits?" in said.what and "by 16" in said.advice


def test_dark_files_of_sixteen_bits_are_not_refused(tmp_path):
    write_sixteen_bits(tmp_path / "data", 64)
    findings = check_scene(gsut.load_dataset(tmp_path / "data"))
    (said,) = [f for f in findings if "bits a channel" in f.what]
    assert said.severity == "warning" and "14 bits?" in said.what


def test_files_that_use_their_sixteen_bits_are_not_refused(tmp_path):
    write_sixteen_bits(tmp_path / "data", 257)
    findings = check_scene(gsut.load_dataset(tmp_path / "data"))
    assert [f for f in findings if "bits a channel" in f.what] == []
