"""Benchmarks of captures: films, poses and pycolmap, a command that is watched."""

import json

import numpy as np
import pytest

import gsut
import tolerances
from box_room import make_fisheye, plan_walk, write_box_room
from tests.bench import pycolmap_poses
from tests.bench.harness import WRONG, Settings
from tests.bench.poses_bench import (
    BENCHMARK,
    KNOWN,
    UNKNOWN,
    fit_lens,
    measure,
    measure_auc,
    measure_pycolmap,
)
from tests.bench.walk_bench import FILMS, measure_lens_difference, resize_film


def test_films_of_the_database_are_read_in_the_order_of_their_sensor():
    assert FILMS["action camera"](8.0).readout == pytest.approx(0.0166)
    assert FILMS["read upwards"](8.0).readout < 0
    upright = FILMS["phone upright"](8.0)
    # The sensor's first row is the last column of the upright picture.
    assert upright.sideways and upright.readout < 0
    assert upright.camera.width < upright.camera.height


def test_film_of_another_size_has_the_same_lens():
    film = FILMS["dual fisheye"](8.0)
    wanted = Settings({"scale": 0.5, "samples": 2, "frame_rate": 5.0})
    small = resize_film(film, wanted)
    assert (small.camera.width, small.back.width, len(small.times)) == (192, 192, 40)
    assert measure_lens_difference(small.camera.resize(384, 384), film.camera) < 1e-9


# Poses.


VIEWS = 8


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """Photographs of an eighth of the walk, on which they share enough."""
    folder = tmp_path_factory.mktemp("poses") / "room"
    return write_box_room(folder, make_fisheye(160), plan_walk(VIEWS, 1 / 8))


def find_room_poses(room, tmp_path, lens):
    settings = BENCHMARK.settings(tmp_path, threads=1, lens=(lens,))
    settings.sets = (str(room),)
    (case,) = BENCHMARK.cases(settings)
    return measure(case, settings)


def test_poses_with_the_lens_have_errors_beside_seconds(room, tmp_path):
    row = find_room_poses(room, tmp_path, KNOWN)
    assert row["images"] == row["registered"] == VIEWS and row["cpu_seconds"] > 0
    assert row["centers_percent"] < 2 and row["rotation_max_degrees"] < 2
    assert "focal_sigma_percent" not in row


def test_auc_of_pairs_counts_lost_images_and_errors_by_their_share_of_the_limit():
    truth = {name: np.eye(4) for name in ("a", "b", "c")}
    for step, name in enumerate(truth):
        truth[name][0, 3] = step * (step + 1)
    turned = np.eye(4)
    turned[:3, :3] = [[0.9990482, -0.0436194, 0], [0.0436194, 0.9990482, 0], [0, 0, 1]]
    found = {"a": truth["a"], "b": turned @ truth["b"]}  # 2.5 degrees; c has no pose
    areas = measure_auc(found, truth)
    assert areas["auc_1"] == 0
    assert areas["auc_5"] == pytest.approx(50 / 3, rel=tolerances.AUC_ROUNDING)
    assert areas["auc_10"] == pytest.approx(25, rel=tolerances.AUC_ROUNDING)


@pytest.mark.slow
def test_poses_without_the_lens_state_its_uncertainty(room, tmp_path):
    row = find_room_poses(room, tmp_path, UNKNOWN)
    # Few views of a few pixels: the lens is found, or the reason why not.
    assert WRONG in row or row["focal_sigma_percent"] > 0


def test_a_python_without_pycolmap_is_named(room, tmp_path):
    python = tmp_path / "python"
    python.write_text(f"#!/bin/sh\nexit {pycolmap_poses.MISSING}\n")
    python.chmod(0o755)
    row = measure_pycolmap(room, "known", str(python), 1)
    assert row["registered"] == 0 and "has no pycolmap: pip install" in row[WRONG]
    with pytest.raises(gsut.InputError, match="cannot be run"):
        measure_pycolmap(room, "known", str(tmp_path / "absent"), 1)


def test_poses_of_pycolmap_are_compared_after_a_similarity(room, tmp_path):
    # A stand-in answers with the dataset's own poses, moved and scaled: no error is left.
    scene = gsut.load_dataset(room, test_every=0)
    poses = {}
    for view in scene.views:
        pose = view.camera_from_world.copy()
        pose[:3, 3] = 2.0 * (pose[:3, 3] - pose[:3, :3] @ [1.0, 2.0, 3.0])
        poses[view.image_path.resolve().name] = pose[:3].tolist()
    seconds = {"features": 1, "matching": 2, "mapping": 3}
    answer = tmp_path / "answer.json"
    answer.write_text(json.dumps({"poses": poses, "seconds": seconds, "cpu_seconds": seconds}))
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\ncp {answer} "$3"\n')
    python.chmod(0o755)
    row = measure_pycolmap(room, "known", str(python), 1)
    assert row["registered"] == VIEWS and row["seconds"] == 6
    assert row["centers_percent"] < 1e-8 and row["rotation_max_degrees"] < 1e-8


def test_a_lens_of_another_model_is_fitted_to_the_datasets_own(room, tmp_path):
    own = gsut.load_dataset(room).cameras[0]
    fitted = gsut.load_camera(fit_lens(room, "kannala_brandt", tmp_path))
    assert fitted.model == own.model == "kannala_brandt"
    assert fitted.params == pytest.approx(own.params, rel=tolerances.SFM_FOCAL)
