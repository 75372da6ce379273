"""Photographs that cannot be calibrated from: one sentence each, naming the file."""

import json

import cv2
import numpy as np
import pytest

from calib.boards.images import read_grey
from calib_fakes import write_pictures
from gsut.cli import main


@pytest.fixture(scope="module")
def pictures(tmp_path_factory):
    """Ten drawn boards; paths."""
    folder = tmp_path_factory.mktemp("photographs")
    return write_pictures(folder, 10, np.random.default_rng(21))[0]


def calibrate(folder, images, board="7x5"):
    """Runs `gsut calibrate` on images; returns its exit status."""
    words = ["calibrate", *map(str, images), "--board", board, "--spacing", "0.03", "--quiet"]
    return main([*words, "--lens", "fisheye", "-o", str(folder / "lens.yaml")])


def changed(folder, paths, change):
    """The pictures after a change, as files of their own."""
    written = []
    for path in paths:
        written.append(folder / f"changed-{path.name}")
        cv2.imwrite(str(written[-1]), change(read_grey(path)))
    return written


def blurred(image):
    return cv2.GaussianBlur(image, (0, 0), 7)


def cropped(image):
    """What lies left of the board's middle, by its bright paper; the rest is grey."""
    middle = int(np.flatnonzero((image > 200).any(axis=0)).mean())
    return np.where(np.arange(image.shape[1]) < middle, image, 110).astype(np.uint8)


def empty(image):
    return np.full_like(image, 128)


def half_size(image):
    return cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)


def add(name, write):
    """Four pictures and a file that `write` makes of the first."""

    def make(folder, paths):
        write(folder / name, paths[0])
        return [*paths[:4], folder / name]

    return make


def change_four(change):
    return lambda folder, paths: changed(folder, paths[:4], change)


@pytest.mark.parametrize(
    ("make", "board", "sentence"),
    [
        (change_four(empty), "7x5", "no board of 7 x 5 inner corners in any of the 4 images"),
        (
            lambda folder, paths: [*paths[:3], *changed(folder, paths[3:5], empty)],
            "7x5",
            "too few boards: 3 found in 5 images",
        ),
        (
            lambda folder, paths: [*paths[:4], *changed(folder, paths[4:5], half_size)],
            "7x5",
            "all images of one camera must have one size",
        ),
        (change_four(blurred), "7x5", "blurred"),
        (change_four(cropped), "7x5", "cropped"),
        (change_four(lambda i: i[:, :4]), "7x5", "4 x 320 pixels are too few for a board of 7 x 5"),
        (change_four(lambda i: i[:14, :14]), "7x5", "14 x 14 pixels are too few for a board"),
        (
            add("changed-note.png", lambda file, _: file.write_text("this is no image")),
            "7x5",
            "not a readable image",
        ),
        (
            add("changed-half.png", lambda file, of: file.write_bytes(of.read_bytes()[:-100])),
            "7x5",
            "the image is cut off after",
        ),
        (add("changed-absent.png", lambda *_: None), "7x5", "cannot be opened"),
        (lambda _, paths: paths[:3], "8x6", "show 7 x 5 inner corners, not 8 x 6"),
        (lambda _, paths: paths[:3], "6x4", "show 7 x 5 inner corners, not 6 x 4"),
    ],
)
def test_calibrate_bad_photographs_are_one_sentence_with_the_file(
    make, board, sentence, pictures, tmp_path, capsys
):
    images = make(tmp_path, pictures)
    assert calibrate(tmp_path, images, board) == 2
    said = capsys.readouterr().err
    assert said.startswith("gsut: error: ")
    assert said.count("\n") == 1
    assert sentence in said
    changed_ones = [path for path in images if path.name.startswith("changed")]
    assert any(str(path) in said for path in changed_ones or images)
    assert not list(tmp_path.glob("lens*"))


def test_calibrate_some_bad_photographs_are_left_out_and_reported(pictures, tmp_path, capsys):
    spoiled = changed(tmp_path, pictures[8:9], blurred) + changed(tmp_path, pictures[9:], empty)
    assert calibrate(tmp_path, [*pictures[:8], *spoiled]) == 0
    said = capsys.readouterr().err
    report = json.loads((tmp_path / "report.json").read_text())
    assert (report["boards_found"], report["boards_total"]) == (8, 10)
    reasons = {row["file"]: row.get("reason") for row in report["cameras"]["camera"]["images"]}
    assert "blurred" in reasons[str(spoiled[0])]
    assert reasons[str(spoiled[1])].startswith("no board is seen")
    assert all(f"{path}: left out: {reasons[str(path)]}" in said for path in spoiled)
    assert all(f"left out: {reasons[str(path)]}" in page(tmp_path) for path in spoiled)


def page(folder):
    return (folder / "report.html").read_text()
