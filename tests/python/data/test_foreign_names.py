"""Names and files as other programs and systems leave them: found, or named with what to do."""

import json
import shutil
import unicodedata

import cv2
import numpy as np
import pytest

import gsut
import small_datasets
from gsut.data.errors import DatasetError

ACCENT = "Übersicht é"


def rename(folder, change):
    """Writes a COLMAP model whose names are changed; the pictures keep theirs."""
    small_datasets.write_colmap_text(folder)
    file = folder / "sparse/0/images.txt"
    rows = file.read_text().splitlines()
    for number, row in enumerate(rows):
        fields = row.split(maxsplit=9)
        if len(fields) == 10 and not row.startswith("#"):
            rows[number] = " ".join([*fields[:9], change(fields[9])])
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    "change",
    [
        lambda name: name.upper(),
        lambda name: name.rpartition(".")[0],
        lambda name: f".\\{name}".replace("/", "\\"),
        lambda name: "C:\\Users\\me\\scan 1\\images\\" + name.replace("/", "\\"),
        lambda name: f"/home/me/scan/images/{name}",
        lambda name: f"file:///home/me/images/{name}",
        lambda name: f"../scan/images/{name}",
        lambda name: "".join(f"%{ord(letter):02x}" for letter in name),
    ],
)
def test_pictures_are_found_under_names_of_other_systems(tmp_path, change):
    whole = gsut.load_dataset(rename(tmp_path / "a", lambda name: name))
    found = gsut.load_dataset(rename(tmp_path / "b", change))
    assert [view.name for view in found.views] == [view.name for view in whole.views]
    assert len(found.views) == small_datasets.VIEWS


def test_letters_of_another_unicode_form_are_the_same(tmp_path):
    folder = rename(tmp_path / "a", lambda name: unicodedata.normalize("NFD", f"{ACCENT} {name}"))
    for path in sorted((folder / "images").rglob("*.png")):
        path.rename(path.with_name(unicodedata.normalize("NFC", f"{ACCENT} {path.name}")))
    found = gsut.load_dataset(folder)
    assert len(found.views) == small_datasets.VIEWS
    assert any("have other names" in note for note in found.notes)


def test_two_pictures_of_one_plain_name_are_not_mixed_up(tmp_path):
    folder = rename(tmp_path / "a", lambda name: name.replace(".png", ".PNG"))
    path = next((folder / "images").rglob("*.png"))
    shutil.copy(path, path.with_name(path.stem + ".Png"))
    assert path.name not in [view.image_path.name for view in gsut.load_dataset(folder).views]


def test_missing_pictures_name_those_that_lie_there(tmp_path):
    folder = rename(tmp_path / "a", lambda name: f"other-{name}")
    with pytest.raises(DatasetError, match=r"none of its 10 images exist .*there lie .*000\.png"):
        gsut.load_dataset(folder)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_byte_order_mark_of_a_model_is_passed_over(tmp_path, name, encoding):
    folder = rename(tmp_path / "a", lambda name: name)
    file = folder / f"sparse/0/{name}.txt"
    file.write_bytes(file.read_text().encode(encoding))
    assert len(gsut.load_dataset(folder).views) == small_datasets.VIEWS


@pytest.mark.parametrize(
    ("write", "old", "new"),
    [
        (small_datasets.write_colmap_text, "images", "input"),
        (small_datasets.write_colmap_text, "images", "Images"),
        (small_datasets.write_colmap_text, "images", "dense/images"),
        (small_datasets.write_colmap_text, "sparse", "Sparse"),
        (small_datasets.write_colmap_text, "sparse", "colmap/sparse"),
        (small_datasets.write_colmap_text, "sparse/0", "sparse/1"),
        (small_datasets.write_folder, "images", "rgb"),
        (small_datasets.write_folder, "images", "IMAGES"),
        (small_datasets.write_folder, "poses.txt", "Poses.TXT"),
        (small_datasets.write_folder, "points3D.ply", "points3d.ply"),
        (small_datasets.write_nerfstudio, "transforms.json", "Transforms.json"),
    ],
)
def test_files_are_found_under_other_usual_names(tmp_path, write, old, new):
    write(tmp_path)
    whole = gsut.load_dataset(tmp_path)
    (tmp_path / old).rename(tmp_path / "moved")
    (tmp_path / new).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / "moved").rename(tmp_path / new)
    found = gsut.load_dataset(tmp_path)
    assert len(found.points) == len(whole.points)
    for one, other in zip(whole.views, found.views, strict=True):
        assert one.image_path.name == other.image_path.name
        np.testing.assert_array_equal(one.camera_from_world, other.camera_from_world)


def test_one_of_several_models_below_is_never_taken(tmp_path):
    small_datasets.write_colmap_text(tmp_path)
    shutil.copytree(tmp_path / "sparse/0", tmp_path / "undistorted/sparse")
    (tmp_path / "sparse/0").rename(tmp_path / "sparse/raw")
    with pytest.raises(DatasetError, match=r"2 COLMAP models: sparse/raw, undistorted/sparse"):
        gsut.load_dataset(tmp_path)


def test_names_in_transforms_json_are_of_any_system(tmp_path):
    small_datasets.write_nerfstudio(tmp_path)
    values = json.loads((tmp_path / "transforms.json").read_text())
    shutil.copytree(tmp_path / "images", tmp_path / "masks")
    names = [frame["file_path"] for frame in values["frames"]]
    for frame, name in zip(values["frames"], names, strict=True):
        frame["mask_path"] = name.replace("images/", "Masks\\")
    values["train_filenames"] = [name.replace("/", "\\").upper() for name in names[:7]]
    values["test_filenames"] = names[7:]
    values["ply_file_path"] = ".\\" + values["ply_file_path"].upper()
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    scene = gsut.load_dataset(tmp_path)
    assert len(scene.train_indices) == 7
    assert all(view.mask_path is not None for view in scene.views)
    assert len(scene.points)


@pytest.mark.parametrize("suffix", [".txt", ".bin"])
def test_two_cameras_of_one_number_are_refused(tmp_path, suffix):
    write = {".txt": small_datasets.write_colmap_text, ".bin": small_datasets.write_colmap_binary}
    write[suffix](tmp_path)
    file = tmp_path / f"sparse/0/cameras{suffix}"
    content = file.read_bytes()
    head = content[:8] if suffix == ".bin" else b""  # the number of cameras
    twice = (2 * int.from_bytes(head, "little")).to_bytes(len(head), "little")
    file.write_bytes(twice + content[len(head) :] + b"\n" * (not head) + content[len(head) :])
    with pytest.raises(gsut.InputError, match="camera 7 is there twice"):
        gsut.load_dataset(tmp_path)


def test_points_ply_of_a_model_are_read(tmp_path):
    folder = rename(tmp_path / "a", lambda name: name)
    points, colors = small_datasets.points()
    (folder / "sparse/0/points3D.txt").unlink()
    small_datasets.write_ply(folder / "sparse/0/points3D.ply", points, colors)
    assert len(gsut.load_dataset(folder).points) == len(points)


def test_scene_of_a_file_for_each_part_is_read_with_its_split(tmp_path):
    small_datasets.write_nerfstudio(tmp_path)
    values = json.loads((tmp_path / "transforms.json").read_text())
    (tmp_path / "transforms.json").unlink()
    parts = {"train": values["frames"][:6], "val": values["frames"][6:8],
             "test": values["frames"][8:]}  # fmt: skip
    for part, frames in parts.items():
        for frame in frames:
            frame["file_path"] = "./" + frame["file_path"].rpartition(".")[0]
        (tmp_path / f"transforms_{part}.json").write_text(json.dumps(values | {"frames": frames}))
    scene = gsut.load_dataset(tmp_path)
    assert (len(scene.train_indices), len(scene.test_indices)) == (6, 2)
    assert any("transforms_val.json" in note for note in scene.notes)
    (tmp_path / "transforms_test.json").unlink()
    assert len(gsut.load_dataset(tmp_path).test_indices) == 2


@pytest.mark.parametrize(
    "name",
    [
        "cameras.xml",
        "reconstruction.json",
        "bundle.out",
        "a.nvm",
        "a.sfm",
        "poses_bounds.npy",
        "scene.mvs",
        "BlocksExchange.xml",
        "cameras.json",
        "a.xmp",
    ],
)
@pytest.mark.parametrize("with_pictures", [True, False])
def test_files_of_other_programs_are_named(tmp_path, name, with_pictures):
    if with_pictures:
        small_datasets.write_images(tmp_path)
    (tmp_path / name).write_text("x")
    with pytest.raises(DatasetError, match=rf"{name} is .*'s: "):
        gsut.load_dataset(tmp_path)


@pytest.mark.parametrize("mask_name", ["masks/{}", "mask.png", "Masks/{}.png", "mask/{}"])
def test_masks_called_as_their_images_and_one_of_all_are_read(tmp_path, mask_name):
    folder = rename(tmp_path / "a", lambda name: name.replace(".png", ".jpg"))
    images = sorted((folder / "images").rglob("*.png"))
    assert len(images) == small_datasets.VIEWS
    mask = np.zeros((small_datasets.HEIGHT, small_datasets.WIDTH), np.uint8)
    mask[: small_datasets.HEIGHT // 2] = 255
    for image in images:
        path = folder / mask_name.format(image.relative_to(folder / "images").with_suffix(".jpg"))
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), mask)
        image.rename(image.with_suffix(".jpg"))
    scene = gsut.load_dataset(folder)
    assert all(scene.mask(i).mean() == 0.5 for i in range(len(scene.views)))


def test_other_models_are_named_with_their_numbers_of_images(tmp_path):
    folder = rename(tmp_path / "a", lambda name: name)
    shutil.copytree(folder / "sparse/0", folder / "sparse/1")
    notes = gsut.load_dataset(folder).notes
    assert any("model of 10 images is used, not sparse/1 of 10" in note for note in notes)


@pytest.mark.parametrize("rows", [3, 4])
def test_matrices_in_lines_are_read(tmp_path, rows):
    folder = small_datasets.write_folder(tmp_path / "a")
    whole = gsut.load_dataset(folder)
    poses = [np.linalg.inv(view.camera_from_world)[:rows] for view in whole.views]
    lines = [" ".join(f"{x:.17g}" for x in pose.ravel()) for pose in poses]
    (folder / "poses.txt").write_text("\n".join(lines))
    found = gsut.load_dataset(folder)
    for one, other in zip(whole.views, found.views, strict=True):
        np.testing.assert_allclose(one.camera_from_world, other.camera_from_world, atol=1e-9)


@pytest.mark.parametrize("blank", [" ", ";"])
def test_decimal_commas_of_a_trajectory_are_read(tmp_path, blank):
    folder = small_datasets.write_folder(tmp_path / "a")
    plain = gsut.load_dataset(folder)
    file = next(path for path in folder.iterdir() if path.name in ("poses.txt", "trajectory.txt"))
    rows = [row.split() for row in file.read_text().splitlines() if not row.startswith("#")]
    rows = [[row[0], *(f"{float(x):.9f}".replace(".", ",") for x in row[1:])] for row in rows]
    file.write_text("\n".join(blank.join(row) for row in rows))
    found = gsut.load_dataset(folder)
    for one, other in zip(plain.views, found.views, strict=True):
        np.testing.assert_allclose(one.camera_from_world, other.camera_from_world, atol=1e-6)


def test_note_on_lenses_is_said_once(tmp_path):
    folder = rename(tmp_path / "a", lambda name: name)
    file = folder / "sparse/0/images.txt"
    rows, count = file.read_text().splitlines(), 0
    for number, row in enumerate(rows):
        fields = row.split(maxsplit=9)
        if len(fields) == 10 and not row.startswith("#"):
            count += 1
            rows[number] = " ".join([*fields[:8], str(count), fields[9]])
    file.write_text("\n".join(rows) + "\n")
    size = f"{small_datasets.WIDTH} {small_datasets.HEIGHT}"
    (folder / "sparse/0/cameras.txt").write_text(
        "".join(f"{i} OPENCV {size} {40 + i} 40 24 18 0 0 0 0\n" for i in range(1, count + 1))
    )
    notes = [note for note in gsut.load_dataset(folder).notes if "all 0" in note]
    assert len(notes) == 1 and notes[0].startswith("10 lenses (opencv4) have")


def test_mask_in_alpha_alone_is_read(tmp_path):
    from gsut.data.images import decode_mask

    mask = np.full((8, 8, 4), 255, np.uint8)
    mask[:4, :, 3] = 0
    cv2.imwrite(str(tmp_path / "a.png"), mask)
    assert decode_mask(tmp_path / "a.png").mean() == 0.5
    mask[..., :3] = np.random.default_rng(1).integers(0, 2, (8, 8, 1)) * 255
    cv2.imwrite(str(tmp_path / "b.png"), mask)
    np.testing.assert_array_equal(decode_mask(tmp_path / "b.png"), mask[..., 0] > 127)


@pytest.mark.parametrize(("alpha", "share"), [(255, 1.0), (254, 1.0), (250, 1.0), (249, 0.0)])
def test_nearly_full_alpha_is_opaque(tmp_path, alpha, share):
    from gsut.data.images import decode_image

    cv2.imwrite(str(tmp_path / "a.png"), np.full((8, 8, 4), alpha, np.uint8))
    valid = decode_image(tmp_path / "a.png")[1]
    assert valid.mean() == share


def test_masks_of_half_the_size_are_resized(tmp_path):
    folder = rename(tmp_path / "a", lambda name: name)
    mask = np.full((small_datasets.HEIGHT // 2, small_datasets.WIDTH // 2), 255, np.uint8)
    mask[:4] = 0
    small_datasets.write_png(folder / "mask.png", mask)
    seen = gsut.load_dataset(folder).mask(0)
    assert not seen[:8].any() and seen[8:].all()
