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


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_byte_order_mark_of_a_model_is_passed_over(tmp_path, name):
    folder = rename(tmp_path / "a", lambda name: name)
    file = folder / f"sparse/0/{name}.txt"
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert len(gsut.load_dataset(folder).views) == small_datasets.VIEWS


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
    ["cameras.xml", "reconstruction.json", "bundle.out", "a.nvm", "a.sfm", "poses_bounds.npy"],
)
@pytest.mark.parametrize("with_pictures", [True, False])
def test_files_of_other_programs_are_named(tmp_path, name, with_pictures):
    if with_pictures:
        small_datasets.write_images(tmp_path)
    (tmp_path / name).write_text("x")
    with pytest.raises(DatasetError, match=rf"{name} is .*'s: "):
        gsut.load_dataset(tmp_path)


@pytest.mark.parametrize("mask_name", ["masks/{}", "mask.png"])
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
