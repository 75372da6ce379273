"""360-degree pictures: dual fisheyes are split and masked, panoramas know their lens."""

import av
import cv2
import numpy as np
import pytest

import gsut
from gsut.capture import capture
from gsut.capture.panorama import LENSES
from gsut.data.images import decode_mask
from gsut.sfm.photographs.listing import find_photographs
from small_videos import texture, write_video

CIRCLE = 118  # radius, in halves of 256 x 256


def dual_fisheye(shift: int) -> np.ndarray:
    """Two circles of ground, the second one off the middle by (3, -2)."""
    ground = texture()
    halves = []
    for lens, centre in enumerate(((128, 128), (131, 126))):
        start = 100 + 400 * lens + shift
        half = np.maximum(ground[300:556, start : start + 256], 40)
        mask = cv2.circle(np.zeros((256, 256), np.uint8), centre, CIRCLE, 255, -1)
        halves.append(cv2.bitwise_and(half, half, mask=mask))
    return np.hstack(halves)


def panorama(shift: int) -> np.ndarray:
    """A smooth ring of 512 x 256, turned by some columns."""
    x, y = np.meshgrid(np.arange(512), np.arange(256))
    ring = 128 + 60 * np.sin(2 * np.pi * (x + shift) / 512 * 8) * np.cos(y / 20)
    ring += 40 * np.sin(2 * np.pi * (x + shift) / 512 * 31 + y / 7)
    return np.repeat(ring.clip(0, 255).astype(np.uint8)[:, :, None], 3, axis=2)


def write_all(folder, pictures):
    folder.mkdir()
    for i, picture in enumerate(pictures):
        cv2.imwrite(str(folder / f"{i}.png"), picture)
    return folder


def test_dual_fisheye_pictures_become_two_masked_lenses(tmp_path):
    folder = write_all(tmp_path / "in", [dual_fisheye(8 * i) for i in range(3)])
    found = capture([folder], tmp_path / "out")
    names = [row["name"] for row in found.figures["frames"]]
    assert names == [f"{lens}/{i}.jpg" for lens in ("front", "back") for i in range(3)]
    side = found.figures["size"][0]
    assert abs(side - 2 * CIRCLE) <= 2
    back = cv2.imread(str(found.path / "images/back/1.jpg"), cv2.IMREAD_GRAYSCALE)
    rows, columns = np.nonzero(back > 30)
    assert abs(rows.mean() - side / 2) < 2 and abs(columns.mean() - side / 2) < 2  # centred
    mask = decode_mask(found.path / "mask.png")
    assert mask.mean() == pytest.approx(np.pi / 4 * 0.985**2, abs=0.02)
    assert not mask[0, 0] and mask[side // 2, side // 2]
    photographs = find_photographs(found.path, None)
    assert len(photographs) == 6 and not photographs.are_lenses_known
    assert {path for path in photographs.masks} == {found.path / "mask.png"}
    (lens,) = photographs.candidates
    rays, _ = lens.unproject([[side / 2, side / 2 - CIRCLE]])
    assert np.degrees(np.arccos(rays[0, 2])) == pytest.approx(97.5, abs=1)
    again = capture([folder], tmp_path / "out")
    assert again.figures == found.figures


def two_streams(path, pictures):
    """Both halves of pictures as two streams of one file."""
    with av.open(str(path), "w") as out:
        streams = [out.add_stream("mpeg4", rate=30) for _ in range(2)]
        for stream in streams:
            stream.width = stream.height = 256
            stream.bit_rate = 4_000_000
        for picture in pictures:
            for stream, half in zip(streams, np.hsplit(picture, 2), strict=True):
                half = np.ascontiguousarray(half)
                out.mux(stream.encode(av.VideoFrame.from_ndarray(half, format="bgr24")))
        for stream in streams:
            out.mux(stream.encode(None))
    return [path]


def two_files(path, pictures):
    names = [path.with_name(f"{number}-{path.name}") for number in range(2)]
    for number, name in enumerate(names):
        write_video(name, [np.hsplit(picture, 2)[number] for picture in pictures])
    return names


@pytest.mark.parametrize("write", [two_streams, two_files])
def test_two_lenses_in_streams_or_files_of_their_own_are_read_together(tmp_path, write):
    pictures = [dual_fisheye(4 * i) for i in range(12)]
    inputs = write(tmp_path / "walk.mp4", pictures)
    found = capture(inputs, tmp_path / "out", count=4)
    assert found.figures["lenses"] == LENSES
    rows = found.figures["frames"]
    assert len(rows) == 8
    side = found.figures["size"][0]
    flowing = dict.fromkeys(LENSES, 0)
    for row in rows:
        lens, number = row["name"].split("/")[0], row["number"]
        half = np.hsplit(pictures[number], 2)[lens == "back"]
        centre = (131, 126) if lens == "back" else (128, 128)
        left, top = (round(c - side / 2) for c in centre)
        picture = cv2.imread(str(found.path / row["path"])).astype(int)
        inner = slice(side // 4, 3 * side // 4)
        true = half[top : top + side, left : left + side].astype(int)
        assert np.abs(picture[inner, inner] - true[inner, inner]).mean() < 25  # lossy, no mix-up
        flowing[lens] += bool(row["flow"])
        assert all(0 <= x < side and 0 <= y < side for x, y, *_ in row["flow"] or ())
    assert flowing["front"] == flowing["back"] >= 2  # not the first and the last of the video
    photographs = find_photographs(found.path, None)
    assert photographs.frames.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    assert photographs.rig_cameras.tolist() == [0, 1] * 4
    assert [name.split("/")[0] for name in photographs.names[:2]] == ["front", "back"]


def test_two_ordinary_videos_stay_one_after_the_other(tmp_path):
    ground = texture()
    names = [
        write_video(tmp_path / f"{k}.mp4", [ground[k : k + 256, 9 * i : 9 * i + 256]
                                            for i in range(10)])
        for k in (0, 300)
    ]  # fmt: skip
    found = capture(names, tmp_path / "out", count=4)
    assert "lenses" not in found.figures and len(found.figures["frames"]) == 8


def test_video_of_a_panorama_knows_its_lens_and_its_cap_is_masked(tmp_path):
    video = write_video(tmp_path / "walk.mp4", [panorama(6 * i) for i in range(20)])
    found = capture([video], tmp_path / "out", count=4, nadir_cap=20.0)
    photographs = find_photographs(found.path, None)
    assert photographs.are_lenses_known
    assert photographs.cameras[0] == gsut.Camera("equirectangular", [], 512, 256)
    mask = decode_mask(photographs.masks[0])
    rows = mask.all(axis=1)
    assert rows[:227].all() and not rows[229:].any()
    assert any("360-degree panoramas" in note for note in found.notes)


def test_wide_pictures_of_other_cameras_are_left_as_they_are(tmp_path):
    ground = texture()
    folder = write_all(tmp_path / "in", [ground[100:356, s : s + 512] for s in (0, 40, 80)])
    found = capture([folder], tmp_path / "out")
    assert "lens" not in found.figures and len(found.figures["frames"]) == 3
    with pytest.raises(gsut.InputError, match="--nadir-cap must be from 0"):
        capture([folder], tmp_path / "out", nadir_cap=-1.0)
    narrow = write_all(tmp_path / "narrow", [ground[:200, :300]] * 2)
    with pytest.raises(gsut.InputError, match=r"twice as wide as high; these are 300 x 200"):
        capture([narrow], tmp_path / "out2", nadir_cap=10.0)
