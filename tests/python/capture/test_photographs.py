"""Photographs in: what EXIF says, formats that need a library, sizes and cameras that are mixed."""

import subprocess
import sys

import cv2
import numpy as np
import pytest
from PIL import Image

import gsut
from gsut.capture import capture, needs_capture
from gsut.capture.exif import read_facts
from gsut.capture.photographs import collect_photographs, find_photograph_files
from gsut.sfm.lens.candidates import guess_lenses
from gsut.sfm.photographs.listing import find_photographs
from small_videos import walk

FOCAL_35 = 26


def photograph(path, size=(64, 48), mode="RGB", model="ACME One", focal=FOCAL_35, **more):
    """A JPEG, PNG or TIFF whose EXIF names camera, focal length, time, place and orientation."""
    grey = np.linspace(0, 255, size[0] * size[1]).reshape(size[1], size[0]).astype(np.uint8)
    image = Image.fromarray(np.repeat(grey[:, :, None], 3, axis=2)).convert(mode)
    exif = Image.Exif()
    exif[0x010F], exif[0x0110], exif[0x0112] = "ACME", model, more.get("orientation", 1)
    details = exif.get_ifd(0x8769)
    details[0x9003] = f"2024:06:01 12:00:{more.get('second', 0):02d}"
    if focal:
        details[0xA405] = focal
    place = exif.get_ifd(0x8825)
    place.update({1: "S", 2: (33.0, 30.0, 0.0), 3: "E", 4: (10.0, 0.0, 36.0), 5: b"\0", 6: 120.0})
    path.parent.mkdir(exist_ok=True)
    image.save(path, exif=exif)
    return path


def test_facts_of_a_photograph(tmp_path):
    path = photograph(tmp_path / "a.jpg", (400, 300), orientation=6, second=7)
    facts = read_facts(path)
    assert (facts.width, facts.height, facts.camera) == (400, 300, "ACME One")
    assert facts.focal.px == pytest.approx(26 / np.hypot(36, 24) * 500)
    assert facts.orientation == 6
    assert facts.time % 60 == 7
    assert facts.place.to_values() == pytest.approx((-33.5, 10.01, 120.0))


@pytest.mark.parametrize("size", [(1, 1), (5000, 1), (1, 5000)])
def test_photographs_without_a_picture_to_speak_of_are_collected(tmp_path, size):
    photograph(tmp_path / "p/a.png", size)
    collect_photographs([tmp_path / "p"], tmp_path / "out")
    strip = cv2.imread(str(tmp_path / "out/strip.jpg"))
    assert strip.shape[0] == 100 and 0 < strip.shape[1] <= 10 * (4 * 96 + 4)


def test_photographs_stay_where_they_are_and_give_a_lens_to_begin_with(tmp_path):
    for i in range(3):
        photograph(tmp_path / f"p/{i}.jpg", orientation=(1, 6, 1)[i], second=2 * i)
    found = collect_photographs([tmp_path / "p"], tmp_path / "out")
    rows = found.figures["frames"]
    assert [row["path"] for row in rows] == [f"../p/{i}.jpg" for i in range(3)]
    assert [row["time"] for row in rows] == [0, 2, 4]
    assert [row["orientation"] for row in rows] == [1, 6, 1]
    assert found.notes == [] and not list((tmp_path / "out/images").iterdir())
    photographs = find_photographs(tmp_path / "out", None)
    assert [p.resolve() for p in photographs.paths] == sorted((tmp_path / "p").iterdir())
    (lens,) = photographs.candidates
    assert lens.params[0] == pytest.approx(FOCAL_35 / np.hypot(36, 24) * 80)
    perspective = gsut.Camera("pinhole", lens.params[:4], 64, 48)
    rays = perspective.unproject([[40.0, 30.0], [60.0, 40.0]])[0]
    np.testing.assert_allclose(lens.project(rays)[0], [[40, 30], [60, 40]], atol=0.05)


def test_upright_and_smaller_photographs_of_one_camera_are_fitted(tmp_path):
    for i in range(3):
        photograph(tmp_path / f"p/{i}.jpg")
    photograph(tmp_path / "p/upright.jpg", (48, 64))
    photograph(tmp_path / "p/small.jpg", (32, 24))
    found = collect_photographs([tmp_path / "p"], tmp_path / "out")
    assert found.notes == [] and len(found.figures["frames"]) == 5
    written = sorted(path.name for path in (tmp_path / "out/images").iterdir())
    assert written == ["small-jpg.jpg", "upright-jpg.jpg"]
    for row in found.figures["frames"]:
        stored = cv2.imread(str(found.path / row["path"]), cv2.IMREAD_IGNORE_ORIENTATION)
        assert stored.shape[:2] == (48, 64)


def test_other_cameras_zooms_and_shapes_get_a_lens_each(tmp_path):
    for i in range(3):
        photograph(tmp_path / f"p/{i}.jpg")
    photograph(tmp_path / "p/other.jpg", model="Other")
    photograph(tmp_path / "p/square.jpg", (64, 64))
    photograph(tmp_path / "p/zoomed.jpg", focal=70)
    photograph(tmp_path / "p/zoomed_small.jpg", (32, 24), focal=70)
    (tmp_path / "p/broken.jpg").write_bytes(b"\xff\xd8 no photograph")
    found = collect_photographs([tmp_path / "p"], tmp_path / "out")
    broken, several = found.notes
    assert "broken.jpg" in broken and "copy it again" in broken
    assert several.startswith("the photographs are of 4 cameras, zooms or shapes")
    assert "1 of ACME Other, 64 x 48" in several
    groups = find_photographs(tmp_path / "out", None).groups
    names = [row["name"] for row in found.figures["frames"]]
    sorted_names = [{names[i] for i in group.images} for group in groups]
    assert {"0.jpg", "1.jpg", "2.jpg"} in sorted_names and {"other.jpg"} in sorted_names
    zoomed = groups[sorted_names.index({"zoomed.jpg", "zoomed_small-jpg.jpg"})]
    assert zoomed.focal_px == pytest.approx(70 / np.hypot(36, 24) * 80)
    assert {(c.width, c.height) for group in groups for c in group.candidates} == {
        (64, 48), (64, 64)
    }  # fmt: skip


def test_other_size_without_exif_is_a_lens_of_its_own(tmp_path):
    for i in range(3):
        photograph(tmp_path / f"p/{i}.jpg")
    cv2.imwrite(str(tmp_path / "p/edited.png"), np.zeros((64, 48, 3), np.uint8))
    assert "cameras" not in collect_photographs([tmp_path / "p"], tmp_path / "out").figures
    cv2.imwrite(str(tmp_path / "p/edited.png"), np.zeros((72, 96, 3), np.uint8))
    collect_photographs([tmp_path / "p"], tmp_path / "out")
    groups = guess_lenses(find_photographs(tmp_path / "out", None), None).groups
    assert sorted(len(group.images) for group in groups) == [1, 3]
    (alone,) = [group for group in groups if len(group.images) == 1]
    assert alone.focal_px is None and not alone.candidates


def test_sixteen_bits_grey_and_cmyk_are_read(tmp_path):
    photograph(tmp_path / "p/cmyk.jpg", mode="CMYK")
    photograph(tmp_path / "p/grey.jpg", mode="L")
    deep = (np.arange(48 * 64, dtype=np.uint16) * 21).reshape(48, 64)
    cv2.imwrite(str(tmp_path / "p/deep.png"), deep)
    found = collect_photographs([tmp_path / "p"], tmp_path / "out")
    assert "cmyk-jpg.jpg" in {path.name for path in (tmp_path / "out/images").iterdir()}
    assert found.notes == [] and len(found.figures["frames"]) == 3
    cmyk = cv2.imread(str(tmp_path / "out/images/cmyk-jpg.jpg")).astype(int)
    straight = np.linspace(0, 255, 48 * 64).reshape(48, 64)
    assert np.abs(cmyk.mean(axis=2) - straight).mean() < 3


def test_copies_of_photographs_whose_names_meet_are_each_written(tmp_path):
    names = ("p/a/b.heic", "p/a-b.heic", "p/a-b.HEIC")
    pytest.importorskip("pillow_heif").register_heif_opener()
    (tmp_path / "p").mkdir()
    for name in names:
        photograph(tmp_path / name, (128, 96))
    found = collect_photographs([tmp_path / "p/a", tmp_path / "p"], tmp_path / "out")
    written = {(tmp_path / "out" / row["path"]).resolve() for row in found.figures["frames"]}
    assert len(written) == len(names) == len(list((tmp_path / "out/images").iterdir()))


@pytest.mark.parametrize("suffix", ["heic", "tif"])
def test_a_photograph_cut_in_half_is_left_out_and_said(tmp_path, suffix):
    pytest.importorskip("pillow_heif").register_heif_opener()
    mode = "CMYK" if suffix == "tif" else "RGB"  # which is written again
    for i in range(3):
        path = photograph(tmp_path / f"p/{i}.{suffix}", (128, 96), mode)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    found = collect_photographs([tmp_path / "p"], tmp_path / "out")
    assert len(found.figures["frames"]) == 2
    assert any(f"left out: {path}" in note for note in found.notes)


def test_heic_is_read_upright(tmp_path):
    pillow_heif = pytest.importorskip("pillow_heif")
    pillow_heif.register_heif_opener()
    for i in range(2):
        photograph(tmp_path / f"p/{i}.heic", (128, 96))
    found = collect_photographs([tmp_path / "p"], tmp_path / "out")
    assert [row["name"] for row in found.figures["frames"]] == ["0-heic.jpg", "1-heic.jpg"]
    assert found.figures["focal_px"] == pytest.approx(FOCAL_35 / np.hypot(36, 24) * 160)
    assert cv2.imread(str(tmp_path / "out/images/0-heic.jpg")).shape == (96, 128, 3)


@pytest.mark.parametrize(("name", "library"), [("a.heic", "pillow-heif"), ("a.dng", "rawpy")])
def test_a_missing_library_is_named(tmp_path, name, library):
    (tmp_path / name).write_bytes(b"0")
    program = (
        "import sys; sys.modules['pillow_heif'] = sys.modules['rawpy'] = None\n"
        "from gsut.capture.photographs import collect_photographs\n"
        f"collect_photographs([{str(tmp_path)!r}], {str(tmp_path / 'out')!r})"
    )
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert f"pip install {library}; or export the photographs as JPEG" in ran.stderr


def test_damaged_raw_file_is_left_out_in_words(tmp_path):
    pytest.importorskip("rawpy")
    (tmp_path / "a.dng").write_bytes(b"II*\0" + bytes(200))
    with pytest.raises(gsut.InputError, match=r"a\.dng: cannot be read as a raw photograph"):
        collect_photographs([tmp_path], tmp_path / "out")


def test_empty_folder_and_wrong_path_say_what_to_give(tmp_path):
    with pytest.raises(gsut.InputError, match=r"no photographs here.*or a video"):
        collect_photographs([tmp_path], tmp_path / "out")
    with pytest.raises(gsut.InputError, match="no such file or folder"):
        capture([tmp_path / "absent"], tmp_path / "out")


def test_several_videos_of_one_size_are_joined(tmp_path):
    videos = [walk(tmp_path / f"{name}.mp4", frames=12) for name in "ab"]
    found = capture(videos, tmp_path / "out", count=4)
    names = [row["name"] for row in found.figures["frames"]]
    assert [name.split("/")[0] for name in names] == ["1-a"] * 4 + ["2-b"] * 4
    assert all((found.path / row["path"]).is_file() for row in found.figures["frames"])
    assert found.notes[0] == "pictures: 4 of a.mp4, 4 of b.mp4"
    photograph(tmp_path / "p/0.jpg")
    with pytest.raises(gsut.InputError, match=r"different sizes.*320 x 240.*64 x 48"):
        capture([videos[0], tmp_path / "p"], tmp_path / "out2", count=4)


def test_capture_comes_first_where_the_lens_is_not_known(tmp_path):
    photograph(tmp_path / "a.jpg")
    assert needs_capture("walk.mp4", None, False)
    assert needs_capture(str(tmp_path), None, False)
    assert needs_capture(str(tmp_path), "GoPro HERO9", False)
    assert not needs_capture(str(tmp_path), "lens.yaml", False)
    gsut.save_camera(
        gsut.Camera("pinhole", [50.0, 50.0, 32.0, 24.0], 64, 48), tmp_path / "lens.yaml"
    )
    assert not needs_capture(str(tmp_path), None, False)
    assert needs_capture(str(tmp_path), None, True)


def test_unknown_lens_is_not_stopped_by_another_yaml_file(tmp_path):
    for name in "ab":
        photograph(tmp_path / f"{name}.jpg")
    (tmp_path / "config.yaml").write_text("model: no lens\n")
    assert len(find_photographs(tmp_path, None, with_lens=False)) == 2


def test_folders_of_equal_names_keep_all_their_photographs(tmp_path):
    folders = [tmp_path / day / "DCIM" for day in ("mon", "tue", "wed")]
    for folder in folders:
        folder.mkdir(parents=True)
        (folder / "1.jpg").write_bytes(folder.parent.name.encode())
    found = find_photograph_files([*folders, folders[0], folders[1] / "1.jpg"])
    assert list(found) == ["1.jpg", "DCIM/1.jpg", "wed/DCIM/1.jpg"]
    assert list(found.values()) == [folder / "1.jpg" for folder in folders]


def test_mask_of_one_camera_is_no_photograph_but_its_mask(tmp_path):
    images = tmp_path / "images"
    for camera in ("left", "right"):
        (images / camera).mkdir(parents=True)
        for i in range(2):
            photograph(images / camera / f"{i}.jpg")
    cv2.imwrite(str(images / "left/mask.png"), np.full((48, 64), 255, np.uint8))
    cv2.imwrite(str(tmp_path / "mask.png"), np.full((48, 64), 255, np.uint8))
    names = ["left/0.jpg", "left/1.jpg", "right/0.jpg", "right/1.jpg"]
    assert list(find_photograph_files([tmp_path])) == names
    listed = find_photographs(tmp_path, None, with_lens=False)
    assert listed.names == names
    assert listed.masks == [images / "left/mask.png"] * 2 + [tmp_path / "mask.png"] * 2
