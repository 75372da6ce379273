"""Made captures: the same bits from a seed, truth that fits the pictures, rows of commands."""

import json

import cv2
import numpy as np
import pytest

import gsut
import lab_tolerances as tol
from gsut.evaluate.detail import measure_detail
from lab.proving import score
from lab.proving.__main__ import main
from lab.proving.capture import capture
from lab.proving.commands import Outcome
from lab.proving.families import FAMILIES
from lab.proving.misfires import find_misfires
from lab.proving.score import compare_threads, score_made
from lab.proving.truth import (
    classify,
    classify_scene,
    compare_lenses,
    measure_areas,
    measure_pair_errors,
)
from lab.proving.writing import (
    TRUTH,
    find_line_poses,
    find_shares,
    make_capture,
    trace_pictures,
    trace_views,
)

SEEDS = range(24)


@pytest.mark.parametrize("seed", [3, 4])
def test_capture_of_a_seed_made_twice_has_the_same_bits(seed):
    first, second = capture(seed, tiny=True), capture(seed, tiny=True)
    assert first.list_factors() == second.list_factors()
    pairs = list(zip(trace_pictures(first), trace_pictures(second), strict=True))
    assert len(pairs) >= 2
    for one, other in pairs:
        for name in ("image", "clean", "distance", "body"):
            assert np.array_equal(getattr(one, name), getattr(other, name), equal_nan=True)


def test_captures_of_a_block_of_seeds_have_every_family_once():
    drawn = [capture(seed, tiny=True) for seed in range(len(FAMILIES))]
    assert sorted(made.family for made in drawn) == sorted(FAMILIES)


def test_truth_of_rolling_captures_fits_their_pictures():
    """A point found by the depth of one picture has the depth that another one states."""
    checked = 0
    for seed in SEEDS:
        made = capture(seed, tiny=True)
        if made.stage.movers is not None or not made.readout:
            continue
        pictures = list(trace_pictures(made))
        camera, shapes = made.lens.camera, pictures[0].distance.shape
        rows, columns = (axis.ravel() for axis in np.indices(shapes))
        rays, _ = camera.unproject(np.stack([columns, rows], axis=1) + 0.5)
        away = pictures[0].distance.ravel()
        seen = np.isfinite(away)
        pixels = np.stack([columns, rows], axis=1) + 0.5
        poses = find_line_poses(made, made.times[0], find_shares(made, pixels))
        points = np.einsum("nij,nj->ni", poses[:, :3, :3], rays * away[:, None]) + poses[:, :3, 3]
        points = points[seen]
        share = np.full(len(points), 0.5)
        for _ in range(4):  # the line that sees a point
            lines = np.linalg.inv(find_line_poses(made, made.times[1], share))
            there = np.einsum("nij,nj->ni", lines[:, :3, :3], points) + lines[:, :3, 3]
            pixels, valid = camera.project(there)
            share = np.clip(find_shares(made, np.nan_to_num(pixels)), 0, 1)
        valid &= np.all((pixels > 1) & (pixels < np.array(shapes[::-1]) - 1), axis=1)
        if valid.sum() < 200:
            continue
        at = (pixels[valid] - 0.5).astype(np.float32)[None]
        stated = cv2.remap(pictures[1].distance, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[0]
        off = np.abs(stated / np.linalg.norm(there[valid], axis=1) - 1)
        assert np.nanmedian(off) < tol.PROVING_DEPTH, seed
        checked += 1
    assert checked >= 4


def test_wrong_poses_are_poor_and_true_ones_good():
    made = capture(5, tiny=True)
    truth = np.linalg.inv(np.array([made.path(made.times[[k]])[0] for k in range(6)]))
    errors, shifts = measure_pair_errors(dict(enumerate(truth)), truth, made.stage.reach)
    assert measure_areas(errors)["auc_0.5"] == pytest.approx(1, abs=tol.PROVING_AREA)
    assert classify(shifts, 1.0, made.lens.camera) == "good"
    moved = {k: np.roll(truth, 1, axis=0)[k] for k in range(6)}
    errors, shifts = measure_pair_errors(moved, truth, made.stage.reach)
    assert classify(shifts, 1.0, made.lens.camera) == "poor"
    errors, shifts = measure_pair_errors({0: truth[0]}, truth, made.stage.reach)
    assert measure_areas(errors)["auc_10"] == 0
    assert classify(shifts, 1 / 6, made.lens.camera) == "poor"
    _, shifts = measure_pair_errors(dict(enumerate(truth[:4])), truth, made.stage.reach)
    assert classify(shifts, 4 / 6, made.lens.camera) == "usable"  # what is there is right


def test_a_dataset_and_photographs_are_scored_end_to_end(tmp_path):
    kinds = set()
    for seed in SEEDS:
        made = capture(seed, tiny=True)
        if made.kind in kinds or made.kind == "film":
            continue
        kinds.add(made.kind)
        folder = make_capture(made, tmp_path)
        assert len(gsut.load_dataset(folder / TRUTH, test_every=0).views) == made.motion.frames
        row = score_made(made, folder, ("doctor", "poses", "exact"))
        assert not [m for m in find_misfires(row) if m.kind == "traceback"]
        assert row["doctor_status"] in (0, 2)
        assert {"planted", "poses_status"} <= row.keys()
        assert list(row["exact"]) == ["1", str(2 + seed % 7)]
    assert kinds == {"dataset", "photographs"}


def test_poses_of_a_slow_rolling_shutter_do_not_bend(tmp_path):
    # Seven pictures held alike, whose readout shifts them by two pixels.
    made = capture(1)
    row = score_made(made, make_capture(made, tmp_path), ("poses",))
    assert row["auc_5"] > tol.PROVING_SLOW_ROLLING
    assert row["verdict"] == "good"


def test_misfires_of_a_row_are_named():
    row = {
        "seed": 0, "kind": "film", "verdict": "good", "true_class": "poor", "verdict_reasons": [],
        "shift_degrees": 9.0, "auc_1": 0.0, "auc_5": 0.1, "registered": 1.0, "readout_ms": 0.0,
        "readout_px": 0.0, "shutter_found": "top_to_bottom", "readout_found": 0.01,
        "readout_sigma": 1e-3, "planted": "none", "doctor_says": ["error x"], "doctor_errors": 1,
    }  # fmt: skip
    assert [misfire.kind for misfire in find_misfires(row)] == [
        "doctor refuses exact data", "said good, is poor", "readout found on a global shutter"
    ]  # fmt: skip


@pytest.mark.parametrize(("order", "wrong"), [("bottom_to_top", False), ("top_to_bottom", True)])
def test_readout_is_compared_with_its_direction(order, wrong):
    row = {
        "kind": "film", "shutter_found": order, "readout_found": 0.02, "readout_sigma": 2e-3,
        "readout_ms": -22.0, "readout_px": 2.0,
    }  # fmt: skip
    kinds = [misfire.kind for misfire in find_misfires(row)]
    assert kinds == ["readout beyond 3 sigma"] * wrong


def test_what_the_doctor_says_of_exact_data_is_a_misfire():
    row = {"exact": {"1": [], "3": ["error: the photographs contradict", "warning: blurred"]}}
    assert [misfire.kind for misfire in find_misfires(row)] == [
        "doctor refuses exact data", "doctor warns of exact data"
    ]  # fmt: skip


def test_what_is_true_of_exact_data_is_no_misfire():
    said = ["warning given there are no points training starts from random ones"]
    row = {"planted": "none", "doctor_says": said, "doctor_errors": 0}
    assert not list(find_misfires(row))


def test_files_that_depend_on_the_number_of_threads_are_named(tmp_path, monkeypatch):
    def run(*words, work):
        out = words[words.index("-o") + 1]
        out.mkdir()
        (out / "points3D.ply").write_text("the same", encoding="utf-8")
        for file in ("transforms.json", "scene.ply"):
            (out / file).write_text(words[words.index("--threads") + 1], encoding="utf-8")
        return Outcome(0, 0.0, "", "")

    monkeypatch.setattr(score, "run_gsut", run)
    other = compare_threads(capture(0), tmp_path, tmp_path)
    assert other == ["poses: transforms.json", "train: scene.ply"]


@pytest.mark.parametrize(("other", "status"), [([], 0), (["train: scene.ply"], 1)])
def test_run_fails_where_a_promise_is_broken(tmp_path, other, status):
    (tmp_path / "rows.jsonl").write_text(json.dumps({"seed": 7, "other_bits": other}), "utf-8")
    assert main(["--seeds", "7", "-o", str(tmp_path / "rows")]) == status


def test_views_from_a_pictures_own_place_show_the_picture():
    made = next(
        made
        for seed in SEEDS
        if not (made := capture(seed, tiny=True)).readout and made.stage.movers is None
    )
    picture = next(trace_pictures(made))
    view, inside = next(trace_views(made, list(made.path(made.times[[0]]))))
    assert np.array_equal(inside, ~np.isnan(picture.distance))
    assert measure_detail(picture.clean, view / 255.0, inside) > tol.PROVING_SAME_VIEW


@pytest.mark.parametrize(
    ("detail", "registered", "level"),
    [(0.9, 1.0, "good"), (0.9, 0.8, "usable"), (0.5, 1.0, "usable"), (0.9, 0.5, "poor"),
     (0.3, 1.0, "poor"), (None, 1.0, "poor")],
)  # fmt: skip
def test_scene_is_as_good_as_what_it_shows_between_its_pictures(detail, registered, level):
    assert classify_scene(detail, registered) == level


def test_lens_of_photographs_on_their_side_is_compared_as_it_was_held():
    held = gsut.Camera("opencv4", [90, 100, 55, 35, 0.1, 0, 0, 0], 100, 80)
    side = gsut.Camera("opencv4", [100, 90, 35, 45, 0.1, 0, 0, 0], 80, 100)
    assert compare_lenses(side, held, turned=True)["lens_px"] < tol.PROVING_SAME_LENS
    assert compare_lenses(side, held)["lens_px"] > 1
